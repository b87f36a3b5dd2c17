"""The table of what a person can press: words, keys, colours."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Command:
    """One button."""

    name: str
    """Name; that of the service where one button is one service."""
    label: str
    """Words on the button."""
    keys: tuple[str, ...]
    """Keys that press it; the last ones are what foot pedals commonly send."""
    hint: str
    """What it does, in a sentence."""
    color: tuple[int, int, int]
    """Colour of the button; white text on it has a contrast of 4.5 : 1 or more."""


BLUE, GREEN, GREY, RED, ORANGE = (0, 82, 156), (0, 107, 70), (82, 88, 96), (178, 0, 24), (158, 72, 0)

STOP = Command("stop", "STOP  (Esc)", ("escape", "pageup"), "Stops the arm at once.", RED)

TAKE = Command("take_control", "Take control  (C)", ("C",), "Gives the commands from here; others watch.", ORANGE)

LESSON = (
    Command("start_demonstration", "Show a motion  (D)", ("D",), "The arm becomes weightless: lead it to the goal.",
            BLUE),
    Command("finish_demonstration", "I have finished  (F)", ("F", "pagedown"),
            "Ends the showing; the robot learns from it.", GREEN),
    Command("run", "Try it  (T)", ("T",), "The robot moves; pull it where it should move differently.", BLUE),
    Command("ask", "Ask me  (A)", ("A",), "The robot shows two motions and asks which one was better.", BLUE),
    Command("pause", "Pause  (P)", ("P",), "Breaks off what is under way; the arm holds.", GREY),
    Command("reset", "Back to start  (R)", ("R",), "Goes back to the start, also after a stop; keeps what was taught.",
            GREY),
    Command("undo", "Discard the last  (U)", ("U",), "Forgets the newest thing that you taught.", GREY),
    Command("redo", "Give it back  (Y)", ("Y",), "Takes back the newest undo.", GREY),
    Command("save", "Save  (S)", ("S",), "Writes what the robot learned to a file.", GREEN),
)
"""Buttons that are always there."""

ANSWERS = (
    Command("answer_a", "A was better  (1)", ("1",), "The blue motion.", BLUE),
    Command("answer_b", "B was better  (2)", ("2",), "The orange motion.", ORANGE),
    Command("answer_equal", "Equally good  (3)", ("3",), "Both are as good.", GREY),
    Command("answer_neither", "Neither  (4)", ("4",), "Nothing is learned from this.", GREY),
)
"""Buttons of a question."""

RANKS: dict[str, tuple[int, ...]] = {
    "answer_a": (0, 1), "answer_b": (1, 0), "answer_equal": (0, 0), "answer_neither": (),
}
"""Ranks of the two options that each answer stands for."""

ALWAYS = frozenset({"stop", "pause"})
"""Commands that everybody may give, also who only watches: they end motion and start none."""

COMMANDS = {command.name: command for command in (STOP, TAKE, *LESSON, *ANSWERS)}
