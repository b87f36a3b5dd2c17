"""The lesson in a terminal: the page's words, buttons and keys, without its pictures."""

from __future__ import annotations

import asyncio
import signal
import threading
from collections.abc import Iterator
from functools import partial
from typing import Any, ClassVar, Protocol

from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Grid, Horizontal, Vertical
from textual.widgets import Button, DataTable, ProgressBar, Static

from unifeed_ros.console.commands import ANSWERS, COMMANDS, GREY, LESSON, STOP, TAKE, Command
from unifeed_ros.console.health import worst
from unifeed_ros.console.state import KIND_WORDS, LessonView, Phase, Taught, allowed, banner, refusal, watching
from unifeed_ros.console.words import COLOURS, HIGHEST_FORCE, SYMBOLS

LOOK_PERIOD = 0.1
"""Time between two looks at the lesson [s]."""
MARKED = Command("marked", "Forget / give back  (X)", ("X",), "Forgets the marked input, or gives it back.", GREY)


class Lesson(Protocol):
    """What the terminal asks of the node behind it."""

    def view(self) -> LessonView:
        """Give everything that is known now."""

    def press(self, command: str, item: str) -> None:
        """Carry a command of the table out; item is what it is about, or empty."""

    @property
    def in_control(self) -> bool:
        """True while this terminal has control of the lesson."""

    @property
    def other(self) -> str:
        """Who else has control; empty: nobody."""

    def take_control(self) -> None:
        """Take control of the lesson."""


class TeachingTerminal(App[None]):
    """The terminal of one lesson; nothing that comes from elsewhere is read as markup.

    Args:
        lesson: The node behind it.
    """

    TITLE = "Teach the robot"
    ENABLE_COMMAND_PALETTE = False
    CSS = """
    Static { height: auto; }
    #stop { width: 100%; height: 3; text-style: bold; content-align: center middle; }
    #who { height: 3; padding: 1 2; color: white; text-style: bold; }
    #stage { text-style: bold; }
    #stage, #request, #control, #health, #notes, #change { padding: 0 1; }
    #request { min-height: 2; }
    #force, #progress { height: 1; padding: 0 1; }
    #force Static, #progress Static { width: 30; }
    #main { height: 1fr; }
    #buttons { width: 28; padding: 0 1; }
    #buttons Button, #answers Button { width: 100%; }
    #answers { grid-size: 2; grid-rows: 1; height: 2; }
    #question { height: auto; border: heavy #9e4800; }
    #question Static { padding: 0 1; }
    DataTable { height: 1fr; min-height: 3; }
    Button:focus { text-style: bold reverse; }
    Button:disabled { opacity: 100%; text-opacity: 100%; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        *(Binding(",".join({key, key.lower()}), f"give('{command.name}')", command.label, priority=True)
          for command in (*COMMANDS.values(), MARKED) for key in command.keys),
        Binding("ctrl+q,ctrl+c", "quit", "Leave; the session runs on", priority=True)]

    def __init__(self, lesson: Lesson) -> None:
        super().__init__()
        self._lesson, self._view = lesson, LessonView()
        self._items: tuple[Taught, ...] = ()

    def compose(self) -> ComposeResult:
        """Lay the terminal out; it fits 80 columns and 24 lines."""
        yield self._button(STOP, compact=False)
        yield Static(id="who", markup=False)
        yield Static(id="stage", markup=False)
        yield Static(id="request", markup=False)
        for name, total in (("force", HIGHEST_FORCE), ("progress", 1.0)):
            with Horizontal(id=name):
                yield Static(markup=False)
                yield ProgressBar(total, show_percentage=False, show_eta=False)
        with Horizontal(id="main"):
            with Vertical(id="buttons"):
                yield from self._buttons((TAKE, *LESSON, MARKED))
            with Vertical():
                with Vertical(id="question"):
                    yield Static(id="why", markup=False)
                    with Grid(id="answers"):
                        yield from self._buttons(ANSWERS)
                yield DataTable(cursor_type="row", zebra_stripes=True)
                yield Static(id="change", markup=False)
                yield Static(id="notes", markup=False)
        yield Static(id="health", markup=False)
        yield Static(id="control", markup=False)

    def on_mount(self) -> None:
        """Begin to look at the lesson, and leave in order when the connection breaks."""
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGHUP, signal.SIGTERM):
                asyncio.get_running_loop().add_signal_handler(number, self.exit)
        table = self.query_one(DataTable)
        table.add_columns("", "what was taught", "trusted")
        table.focus()  # the arrow keys mark an input
        self.set_interval(LOOK_PERIOD, self.look)
        self.look()

    def look(self) -> None:
        """Bring everything up to date."""
        if not self.is_running:  # the timer may come once more while the terminal closes
            return
        before, self._view = self._view, self._lesson.view()
        view, lines = self._view, banner(self._view)
        self._say("who", f"{SYMBOLS[lines.kind]} {lines.who}")
        self.query_one("#who").styles.background = COLOURS[lines.kind]
        self._say("stage", lines.stage)
        self._say("request", lines.request)
        self._measure("force", f"force at the hand: {view.force:.0f} N", min(view.force, HIGHEST_FORCE))
        thinking = view.phase in (Phase.LEARNING, Phase.PLANNING) or view.busy
        learning = view.phase is Phase.LEARNING or (view.busy and view.progress < 1.0)
        self._measure("progress", f"learning: {100 * view.progress:.0f} %" if learning else "planning",
                      view.progress if learning else None, shown=thinking)
        self._show_buttons()
        self._show_question()
        self._show_items()
        marked = self._marked()
        self._say("change", f"what it changed: {marked.change}" if marked is not None and marked.change else "")
        self._say("notes", "\n".join(view.notes[-2:]))
        sick = worst(view.health)
        self._say("health", f"! {sick.name}: {sick.text}. {sick.remedy}" if sick else "health: all is well")
        self._say("control", "You teach from this terminal." if self._lesson.in_control else watching(
            self._lesson.other))
        if view.phase is Phase.ASKING and before.phase is not Phase.ASKING:
            self.bell()

    def action_give(self, command: str) -> None:
        """Give a command, as its key or its button does; what was refused is said."""
        item = ""
        if command == TAKE.name:
            self._lesson.take_control()
            return
        if command == MARKED.name:
            if (marked := self._marked()) is None:
                return
            command, item = "redo" if marked.taken_back else "undo", marked.id
        reason = refusal(self._view, command, self._lesson.other, in_control=self._lesson.in_control)
        if reason:
            self.notify(reason, severity="warning", markup=False)
        else:
            self._lesson.press(command, item)

    def on_button_pressed(self, event: Button.Pressed) -> None:
        """Give the command of a button."""
        self.action_give(str(event.button.id))

    def _button(self, command: Command, *, compact: bool = True) -> Button:
        button = Button(Text(command.label), id=command.name, compact=compact, tooltip=command.hint)
        _colour(button, command)
        return button

    def _buttons(self, commands: tuple[Command, ...]) -> Iterator[Button]:
        return map(self._button, commands)

    def _show_buttons(self) -> None:
        possible, marked = allowed(self._view), self._marked()
        if marked is not None and ("redo" if marked.taken_back else "undo") in possible:
            possible |= {MARKED.name}
        for command in (TAKE, *LESSON, *ANSWERS, MARKED):
            may = not self._lesson.in_control if command is TAKE else command.name in possible
            button = self.query_one(f"#{command.name}", Button)
            if button.disabled == may:
                button.disabled = not may
                _colour(button, command)

    def _show_question(self) -> None:
        view = self._view
        asked = view.question if view.phase is Phase.ASKING else None
        self.query_one("#question").display = asked is not None
        if asked is not None:
            told = "" if "bit" in asked.reason else f" Expected information: {asked.information:.2f} bit."
            self._say("why", f"Why it is asked: {asked.reason}.{told}")

    def _show_items(self) -> None:
        if self._view.items == self._items:
            return
        self._items = self._view.items
        table = self.query_one(DataTable)
        row = table.cursor_row
        table.clear()
        for number, item in enumerate(self._items, start=1):
            line = partial(Text, style="dim strike" if item.taken_back else "")
            table.add_row(*map(line, (str(number), KIND_WORDS.get(item.kind, "Something"),
                                      "forgotten" if item.taken_back else f"{100 * item.reliability:.0f} %")))
        table.move_cursor(row=min(max(row, 0), len(self._items) - 1))

    def _marked(self) -> Taught | None:
        row = self.query_one(DataTable).cursor_row
        return self._items[row] if 0 <= row < len(self._items) else None

    def _say(self, name: str, text: str) -> None:
        widget: Any = self.query_one(f"#{name}", Static)
        if getattr(widget, "said", None) != text:
            widget.said = text
            widget.update(Text(text))

    def _measure(self, name: str, words: str, value: float | None, *, shown: bool = True) -> None:
        """Show a bar; None: something goes on, nobody knows how far it is."""
        row = self.query_one(f"#{name}")
        row.display = shown
        row.query_one(Static).update(Text(words))
        bar = row.query_one(ProgressBar)
        if value is None:
            bar.update(total=None)
        else:
            bar.update(total=HIGHEST_FORCE if name == "force" else 1.0, progress=value)


def _colour(button: Button, command: Command) -> None:
    """Give a button the page's colours: white on its own, or light grey on dark where it cannot be pressed."""
    button.styles.color = "#9aa0a8" if button.disabled else "white"
    button.styles.background = "#22252a" if button.disabled else "rgb({},{},{})".format(*command.color)
