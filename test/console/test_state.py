"""What the page says and allows, phase by phase."""

from __future__ import annotations

from dataclasses import replace

import pytest

from unifeed_ros.console.commands import ANSWERS, COMMANDS, LESSON, RANKS, STOP
from unifeed_ros.console.state import LessonView, Phase, Question, Taught, allowed, banner, steps
from unifeed_ros.core.modes import Control, TeachingMode

READY = LessonView(phase=Phase.READY, mode=TeachingMode.HOLD, message="ready: start_demonstration, run or ask")
ITEM = Taught(id="demonstration-1", kind=1)
ASKED = Question(id="query-1", information=0.5, reason="the networks disagree")


@pytest.mark.parametrize("phase", Phase)
@pytest.mark.parametrize("mode", TeachingMode)
@pytest.mark.parametrize("busy", [False, True])
def test_stop_is_always_there_and_every_state_says_something(phase, mode, busy):
    view = replace(READY, phase=phase, mode=mode, busy=busy)
    assert "stop" in allowed(view) and allowed(view) <= set(COMMANDS)
    said = banner(view)
    assert said.who and said.stage and said.request


@pytest.mark.parametrize(("phase", "wanted", "refused"), [
    (Phase.READY, {"start_demonstration", "run"}, {"finish_demonstration", "pause", "answer_a"}),
    (Phase.DEMONSTRATING, {"finish_demonstration", "pause"}, {"start_demonstration", "run", "undo"}),
    (Phase.RUNNING, {"pause", "reset"}, {"run", "ask", "undo"}),
    (Phase.PAUSED, {"run", "reset"}, {"pause", "ask"}),
    (Phase.FAULT, {"reset"}, {"run", "pause", "start_demonstration"}),
    (Phase.WAITING, {"stop"}, {"reset", "run"}),
])
def test_buttons_follow_the_phase(phase, wanted, refused):
    names = allowed(replace(READY, phase=phase))
    assert wanted <= names and not refused & names


def test_a_stopped_arm_only_goes_back_to_the_start():
    assert allowed(replace(READY, mode=TeachingMode.STOPPED, items=(ITEM,))) == {"stop", "reset"}
    assert "Back to start" in banner(replace(READY, mode=TeachingMode.STOPPED)).request


def test_an_answer_can_be_given_once():
    asking = replace(READY, phase=Phase.ASKING, question=ASKED)
    assert set(RANKS) <= allowed(asking)
    assert not set(RANKS) & allowed(replace(asking, question=replace(ASKED, answered=True)))
    assert not set(RANKS) & allowed(replace(asking, question=None))


def test_undo_and_redo_need_something_to_act_on():
    assert not {"undo", "redo"} & allowed(READY)
    assert {"undo", "redo"} & allowed(replace(READY, items=(ITEM,))) == {"undo"}
    assert {"undo", "redo"} & allowed(replace(READY, items=(replace(ITEM, taken_back=True),))) == {"redo"}


def test_the_steps_of_a_first_lesson_lead_on():
    view = READY
    for kind, title in ((1, "Show a motion"), (2, "Correct it"), (3, "Answer a question")):
        step = next(s for s in steps(view) if not s.done)
        assert step.title == title and banner(view).request == step.text
        view = replace(view, items=(*view.items, Taught(id=str(kind), kind=kind)))
    assert [s.done for s in steps(replace(view, saved="file"))] == [True] * 4
    assert not steps(replace(view, items=(replace(ITEM, taken_back=True),)))[0].done


@pytest.mark.parametrize(("control", "mode", "kind"), [
    (Control.PERSON, TeachingMode.TRACK, "person"), (Control.ROBOT, TeachingMode.TRACK, "robot"),
    (Control.PERSON, TeachingMode.STOPPED, "stopped"), (Control.NOBODY, TeachingMode.HOLD, "nobody"),
])
def test_the_banner_says_who_has_control(control, mode, kind):
    assert banner(replace(READY, phase=Phase.RUNNING, control=control, mode=mode)).kind == kind


def test_every_key_presses_one_button():
    keys = [key for command in COMMANDS.values() for key in command.keys]
    assert len(keys) == len(set(keys)) and all(command.keys for command in (STOP, *LESSON, *ANSWERS))


@pytest.mark.parametrize("command", COMMANDS.values(), ids=lambda c: c.name)
def test_white_words_on_buttons_can_be_read(command):
    """Contrast of WCAG 2.1: (L1 + 0.05) / (L2 + 0.05), at least 4.5."""
    channels = [c / 255 for c in command.color]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    luminance = 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
    assert 1.05 / (luminance + 0.05) >= 4.5
