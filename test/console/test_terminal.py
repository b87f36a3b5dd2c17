"""The terminal: what it shows, what its keys do, and that nothing it shows is read as markup."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest
from textual.widgets import Button, DataTable, Static

from unifeed_ros.console.commands import ANSWERS, COMMANDS, LESSON, TAKE
from unifeed_ros.console.state import HealthLine, LessonView, Phase, Question, Taught, allowed
from unifeed_ros.console.terminal import TeachingTerminal
from unifeed_ros.core.modes import Control, TeachingMode

EVIL = "[red]x[/red] [@click=app.quit]"
READY = LessonView(phase=Phase.READY, mode=TeachingMode.HOLD, has_model=True, drawn=False, force=12.0, items=(
    Taught(id="demonstration-1", kind=1, reliability=0.25, change=EVIL), Taught(id="correction-1", kind=2)))
ASKING = replace(READY, phase=Phase.ASKING, question=Question(id="q", information=0.5, reason=EVIL))


class Lesson:
    """A lesson that stands still and writes down what is pressed."""

    def __init__(self, view, in_control=True, other=""):
        self.shown, self.in_control, self.other, self.pressed = view, in_control, other, []

    def view(self):
        return self.shown

    def press(self, command, item):
        self.pressed.append((command, item))

    def take_control(self):
        self.in_control, self.other = True, ""


def visit(lesson, look, size=(80, 24)):
    """Let a person look at the terminal and use it: look(app, pilot)."""
    async def run():
        app = TeachingTerminal(lesson)
        async with app.run_test(size=size) as pilot:
            await pilot.pause()
            await look(app, pilot)

    asyncio.run(run())


def words(app, name):
    return str(app.query_one(f"#{name}", Static).content)


def test_everything_fits_a_terminal_of_80_by_24():
    async def look(app, _):
        for widget in (*app.query(Button), app.query_one(DataTable), *map(app.query_one, ("#health", "#control"))):
            place = widget.region
            assert place.area > 0 and place.right <= 80 and place.bottom <= 24, widget
        assert words(app, "who").endswith("YOU have control")

    view = replace(ASKING, control=Control.PERSON, health=(HealthLine(name="disk", level=1, text="full"),))
    visit(Lesson(view), look)


@pytest.mark.parametrize("view", [ASKING, replace(READY, mode=TeachingMode.STOPPED)])
def test_keys_give_what_makes_sense_and_stop_always(view):
    lesson = Lesson(view)

    async def look(_, pilot):
        for command in COMMANDS.values():
            for key in command.keys:
                await pilot.press(key.lower())

    visit(lesson, look)
    wanted = [c.name for c in COMMANDS.values() for _ in c.keys if c.name in allowed(view) | {"pause"}]
    assert [name for name, _ in lesson.pressed] == wanted


def test_who_watches_may_stop_and_take_control():
    lesson = Lesson(READY, in_control=False, other=f"a page {EVIL}")

    async def look(app, pilot):
        assert words(app, "control") == f"You are watching: a page {EVIL} has control."
        await pilot.press("d", "escape")
        assert lesson.pressed == [("stop", "")]
        await pilot.press("c", "d")
        app.look()
        assert lesson.pressed[1:] == [("start_demonstration", "")]
        assert words(app, "control") == "You teach from this terminal."
        assert app.query_one(f"#{TAKE.name}", Button).disabled

    visit(lesson, look)


def test_any_input_is_forgotten_and_given_back():
    lesson = Lesson(READY)

    async def look(app, pilot):
        await pilot.press("x", "down", "x")
        lesson.shown = replace(READY, items=(READY.items[0], replace(READY.items[1], taken_back=True)))
        app.look()
        await pilot.press("x")
        await pilot.click("#undo")

    visit(lesson, look)
    assert lesson.pressed == [("undo", "demonstration-1"), ("undo", "correction-1"), ("redo", "correction-1"),
                              ("undo", "")]


def test_texts_of_others_are_shown_as_text():
    async def look(app, _):
        cells = app.query_one(DataTable).get_row_at(0)
        assert [str(cell) for cell in cells] == ["1", "You showed a motion", "25 %"]
        assert not any(cell.spans for cell in cells)
        assert EVIL in words(app, "change") and EVIL in words(app, "why")
        assert EVIL in words(app, "notes") and EVIL in words(app, "health")
        assert "0.50 bit" in words(app, "why")

    visit(Lesson(replace(ASKING, notes=(EVIL,), health=(HealthLine(name=EVIL, level=2, text=EVIL),))), look)


def test_buttons_follow_the_phase_and_the_question_comes_and_goes():
    lesson = Lesson(READY)

    async def look(app, _):
        for view in (READY, ASKING, READY):
            lesson.shown = view
            app.look()
            assert app.query_one("#question").display == (view is ASKING)
            for command in (*LESSON, *ANSWERS):
                assert app.query_one(f"#{command.name}", Button).disabled == (command.name not in allowed(view))

    visit(lesson, look)
