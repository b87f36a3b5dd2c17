"""The widgets of the page: banner and stop, buttons, question, what was taught, how it looks, health."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import viser

from unifeed_ros.console.commands import ANSWERS, LESSON, STOP, TAKE, Command
from unifeed_ros.console.drawing import scale_legend
from unifeed_ros.console.state import LessonView, Phase, Taught, allowed
from unifeed_ros.console.words import (
    STYLE,
    banner_html,
    health_html,
    notes_html,
    question_html,
    sound_html,
    steps_html,
    taught_html,
)

Press = Callable[[str, str, int | None], None]
"""Called with the command, the item that it is about (or nothing), and the page that pressed."""

TOGETHER, IN_TURN, STILL = "together", "in turn", "still"
WIDTH = 400
"""Width of the panel at the right [px]."""
NO_PAST = "none"


@dataclass(frozen=True, kw_only=True)
class Look:
    """What the person chose to see."""

    before: bool
    """The motion before the last input."""
    past: str
    """Name of a past motion; NO_PAST for none."""
    slice: bool
    """The reward on a level slice."""
    height: float
    """Height of the slice [m]."""
    play: str
    """How the ghosts of a question move: TOGETHER, IN_TURN or STILL."""


class LessonPanel:
    """The widgets.

    Args:
        server: The page.
        press: Gets every press of a button or a key.
        floor: Lowest height of the slice [m].
    """

    def __init__(self, server: viser.ViserServer, press: Press, floor: float) -> None:
        self._gui, self._press = server.gui, press
        self._buttons: dict[str, viser.GuiButtonHandle] = {}
        self._rows: dict[str, tuple[viser.GuiHtmlHandle, viser.GuiButtonHandle]] = {}
        self._said: dict[int, str] = {}
        self._sounds = 0
        self._build_banner()
        self._build_main(floor)

    def _build_banner(self) -> None:
        """Put the banner and the stop button where no scrolling hides them."""
        panel = self._gui.add_panel()
        with panel.add_tab("Lesson", viser.Icon.ROBOT):
            self._add_button(STOP)
            self._add_keys(TAKE)  # its button is not the same on every page
            self._banner = self._gui.add_html(STYLE)
        panel.float(x=12, y=-12, width=430)  # notes come at the top: they must not cover the stop button

    def _build_main(self, floor: float) -> None:
        gui = self._gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(0, 82, 156))
        gui.set_panel_label("Teach the robot")
        gui.main_panel.dock_right()
        gui.main_panel.set_width(WIDTH)
        self._question_folder = gui.add_folder("Question", visible=False)
        with self._question_folder:
            self._question = gui.add_html("")
            for command in ANSWERS:
                self._add_button(command)
            self._play = gui.add_button_group("Play A and B", (TOGETHER, IN_TURN, STILL))
            self._playing = TOGETHER

            @self._play.on_click
            async def _(event: viser.GuiEvent) -> None:
                self._playing = event.target.value
        tabs = gui.add_tab_group()
        with tabs.add_tab("Teach"):
            self._steps = gui.add_html("")
            for command in LESSON:
                self._add_button(command)
            self._notes = gui.add_html("")
        self._taught = tabs.add_tab("Taught")
        with self._taught:
            self._nothing = gui.add_html('<div style="padding:6px 12px;font-family:sans-serif">Nothing yet.</div>')
        with tabs.add_tab("Look"):
            self._build_look(floor)
        with tabs.add_tab("Health"):
            self._health = gui.add_html("")
            self._sound_on = gui.add_checkbox("Sound", True, hint="A sound for touch, hand-back and questions.")
            self._sound = gui.add_html("")

    def _build_look(self, floor: float) -> None:
        gui = self._gui
        gui.add_html(f'<div style="padding:6px 12px;font-family:sans-serif;color:#16181c">'
                     f"The tube is the motion that the robot plans.{scale_legend()}</div>")
        self._before = gui.add_checkbox("Plan before", True, hint="The plan before the last input, as a broken line.")
        self._past = gui.add_dropdown("Past motion", (NO_PAST,))
        self._slice = gui.add_checkbox("Reward slice", False, hint="The learned reward, level through the workspace.")
        self._height = gui.add_slider("Slice height (m)", floor, floor + 0.8, 0.01, floor + 0.1)

    @property
    def look(self) -> Look:
        """What the person chose to see."""
        return Look(before=self._before.value, past=self._past.value, slice=self._slice.value,
                    height=self._height.value, play=self._playing)

    def show(self, view: LessonView) -> None:
        """Bring the widgets up to date; what has not changed is not sent again."""
        possible = allowed(view)
        for name, button in self._buttons.items():
            if button.disabled != (name not in possible):
                button.disabled = name not in possible
        asking = view.phase is Phase.ASKING and view.question is not None
        if self._question_folder.visible != asking:
            self._question_folder.visible = asking
        for widget, text in ((self._banner, banner_html(view)), (self._steps, steps_html(view)),
                             (self._question, question_html(view)), (self._notes, notes_html(view)),
                             (self._health, health_html(view.health))):
            if self._said.get(id(widget)) != text:
                self._said[id(widget)] = text
                widget.content = text
        self._show_items(view.items, view.phase)

    def show_past(self, names: Sequence[str]) -> None:
        """Offer past motions by name."""
        if tuple(self._past.options) != (NO_PAST, *names):
            self._past.options = (NO_PAST, *names)

    def play_sound(self, frequencies: tuple[float, ...]) -> None:
        """Play tones one after the other [Hz], if the person wants sound."""
        if self._sound_on.value:
            self._sounds += 1
            self._sound.content = sound_html(frequencies, self._sounds)

    def _show_items(self, items: Sequence[Taught], phase: Phase) -> None:
        self._nothing.visible = not items
        for name in set(self._rows) - {item.id for item in items}:
            for widget in self._rows.pop(name):
                widget.remove()
        busy = phase not in (Phase.READY, Phase.FAULT, Phase.PAUSED)
        for number, item in enumerate(items, start=1):
            row, button = self._rows.get(item.id) or self._add_row(item.id)
            label = f"Give {number} back" if item.taken_back else f"Forget {number}"
            text = taught_html(number, item)
            if self._said.get(id(row)) != text:
                self._said[id(row)] = row.content = text
            if (button.label, button.disabled) != (label, busy):
                button.label, button.disabled = label, busy

    def _add_row(self, item: str) -> tuple[viser.GuiHtmlHandle, viser.GuiButtonHandle]:
        with self._taught:
            row, button = self._gui.add_html(""), self._gui.add_button("Forget")

        @button.on_click
        async def _(event: viser.GuiEvent) -> None:
            self._press("redo" if button.label.startswith("Give") else "undo", item, event.client_id)

        self._rows[item] = (row, button)
        return row, button

    def _add_button(self, command: Command) -> None:
        button = self._gui.add_button(command.label, color=command.color, hint=command.hint)
        self._buttons[command.name] = button

        @button.on_click
        async def _(event: viser.GuiEvent) -> None:
            self._press(command.name, "", event.client_id)

        self._add_keys(command)

    def _add_keys(self, command: Command) -> None:
        for key in command.keys:
            shortcut = self._gui.add_command(f"{command.label} [{key}]", description=command.hint, hotkey=key)

            @shortcut.on_trigger
            async def _(event: viser.CommandEvent) -> None:
                self._press(command.name, "", event.client_id)
