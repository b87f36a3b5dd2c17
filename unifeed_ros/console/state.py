"""What the page knows of the lesson, and what it says about it in a person's words."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from unifeed_ros.console.commands import ALWAYS, COMMANDS
from unifeed_ros.core.modes import Control, TeachingMode
from unifeed_ros.core.types import Array


class Phase(IntEnum):
    """Where the lesson stands; the numbers of the message LessonState."""

    WAITING = 0
    READY = 1
    DEMONSTRATING = 2
    RUNNING = 3
    LEARNING = 4
    PLANNING = 5
    RETURNING = 6
    SHOWING = 7
    ASKING = 8
    PAUSED = 9
    FAULT = 10


KINDS = {1: "demonstration", 2: "correction", 3: "preference"}
"""Kinds of feedback by their number in the message Feedback."""
KIND_WORDS = {1: "You showed a motion", 2: "You corrected the robot", 3: "You answered a question"}


@dataclass(frozen=True, kw_only=True)
class Taught:
    """One line of the list of what was taught."""

    id: str
    """Name of the input."""
    kind: int
    """Kind, a key of KINDS."""
    paths: tuple[Array, ...] = ()
    """Tool paths for the small drawing, shape (N, 3) each [m]; the first is what the person wanted."""
    reliability: float = 1.0
    """How far this kind was trusted in the newest model, 0 to 1 [1]."""
    change: str = ""
    """What it changed in the plan, as a sentence; empty while that is not known."""
    taken_back: bool = False
    """True after an undo; redo gives it back."""


@dataclass(frozen=True, kw_only=True)
class Question:
    """A question that waits for its answer."""

    id: str
    """Name of the query."""
    information: float
    """Expected information of the answer [bit]."""
    reason: str
    """Why it is asked."""
    answered: bool = False
    """True once an answer was sent."""


@dataclass(frozen=True, kw_only=True)
class HealthLine:
    """How one part of the session is."""

    name: str
    """Name of the part."""
    level: int
    """0 well, 1 look at it, 2 broken."""
    text: str
    """A sentence."""
    remedy: str = ""
    """What to do about it; empty when it is well."""


@dataclass(frozen=True, kw_only=True)
class LessonView:
    """Everything that the page shows, at one moment."""

    phase: Phase = Phase.WAITING
    message: str = ""
    """The session's sentence."""
    mode: TeachingMode = TeachingMode.INACTIVE
    control: Control = Control.NOBODY
    stop_reason: str = ""
    """The controller's sentence."""
    force: float = 0.0
    """Force of the person at the hand [N]."""
    interactions: int = 0
    """Interactions completed."""
    progress: float = 1.0
    """Share of the training that is done, 0 to 1 [1]."""
    items: tuple[Taught, ...] = ()
    """What was taught, oldest first."""
    question: Question | None = None
    has_model: bool = False
    """True once a reward was learned."""
    saved: str = ""
    """File of the newest save."""
    busy: bool = False
    """True while the reward is learned again after an undo."""
    corrected: bool = False
    """True once a correction was completed."""
    health: tuple[HealthLine, ...] = ()
    drawn: bool = True
    """True where the motions are drawn beside the words."""
    simulated: bool = False
    """True if the page may pull the arm's hand."""
    taught_by_machine: bool = False
    """True while a simulated person teaches."""
    regret: tuple[float, ...] = ()
    """Normalised regret after each interaction, where the true reward is known [1]."""
    notes: tuple[str, ...] = ()
    """The newest answers of the services, oldest first."""


@dataclass(frozen=True, kw_only=True)
class Banner:
    """The large lines at the top of the page."""

    who: str
    """Who has control."""
    kind: str
    """"robot", "person", "nobody" or "stopped": decides the colour and the symbol."""
    stage: str
    """What the lesson is doing."""
    request: str
    """What the robot asks the person to do now."""


STAGES = {
    Phase.WAITING: "Getting ready", Phase.READY: "Ready", Phase.DEMONSTRATING: "You are showing a motion",
    Phase.RUNNING: "The robot tries it", Phase.LEARNING: "Learning", Phase.PLANNING: "Thinking of a motion",
    Phase.RETURNING: "Going back to the start", Phase.SHOWING: "The robot shows a motion",
    Phase.ASKING: "The robot asks a question", Phase.PAUSED: "Paused", Phase.FAULT: "Something went wrong",
}


def banner(view: LessonView) -> Banner:
    """Say who has control, what happens and what is asked of the person.

    Args:
        view: What is known.

    Returns:
        The lines.
    """
    if view.mode is TeachingMode.STOPPED:
        who, kind = "STOPPED: the arm holds", "stopped"
    elif view.control is Control.PERSON or (view.mode is TeachingMode.GUIDE and view.phase is Phase.DEMONSTRATING):
        who, kind = "YOU have control", "person"
    elif view.mode is TeachingMode.TRACK and view.control is Control.ROBOT:
        who, kind = "THE ROBOT moves", "robot"
    else:
        who, kind = "Nobody moves the arm", "nobody"
    return Banner(who=who, kind=kind, stage=STAGES[view.phase], request=_request(view))


def _request(view: LessonView) -> str:
    if view.mode is TeachingMode.STOPPED and view.phase in (Phase.READY, Phase.FAULT, Phase.PAUSED, Phase.ASKING):
        reason = f" ({view.stop_reason})" if view.stop_reason else ""
        return f'Stopped{reason}. Press "Back to start" to go on. What you taught is kept.'
    grip = "Drag the yellow ball at the hand" if view.simulated else "Take the arm by its hand"
    if view.phase is Phase.DEMONSTRATING:
        return f'{grip} and lead it to the goal. Then press "I have finished".'
    if view.phase is Phase.RUNNING:
        pull = "drag the yellow ball" if view.simulated else "push the arm"
        return f"If the motion is wrong, {pull} where it should go instead. If it is right, do nothing."
    if view.phase is Phase.ASKING:
        if view.question is not None and view.question.answered:
            return "Thank you. Learning from your answer."
        names = "Blue is A, orange is B." if view.drawn else "A was the first one, B the second."
        return f"Which of the two motions is better? {names}"
    if view.phase is Phase.PAUSED:
        return 'Paused. Press "Try it" to go on, or "Back to start".'
    if view.phase is Phase.FAULT:
        return f'{view.message}. Press "Back to start".'
    if view.busy:
        return "One moment: learning again from what is left."
    if view.phase is Phase.READY:
        if view.taught_by_machine:
            return "A simulated person teaches; watch."
        return view.message if view.message.startswith(("no ", "nobody", "the push", "neither")) else _next(view)
    if view.phase is Phase.LEARNING:
        return f"One moment: learning from what you taught ({100 * view.progress:.0f} %)."
    return {Phase.SHOWING: "Watch the arm. Nobody needs to touch it.", Phase.PLANNING: "One moment.",
            Phase.RETURNING: "Wait until the arm is back."}.get(view.phase, view.message)


def _next(view: LessonView) -> str:
    return next((step.text for step in steps(view) if not step.done), "Teach more, or save what it learned.")


@dataclass(frozen=True, kw_only=True)
class Step:
    """One step of the first lesson."""

    title: str
    text: str
    done: bool


def steps(view: LessonView) -> tuple[Step, ...]:
    """List the steps of a first lesson; each says what to press.

    Args:
        view: What is known.

    Returns:
        The steps in order.
    """
    kinds = {item.kind for item in view.items if not item.taken_back}
    drag = "drag the yellow ball at its hand" if view.simulated else "take it by the hand and lead it"
    return (
        Step(title="Show a motion", done=1 in kinds,
             text=f'Press "Show a motion", then {drag} to the green goal.'),
        Step(title="Correct it", done=2 in kinds or view.corrected,
             text='Press "Try it" and pull the arm aside where it moves wrongly.'),
        Step(title="Answer a question", done=3 in kinds, text='Press "Ask me": compare two motions.'),
        Step(title="Save", done=bool(view.saved), text='Press "Save" to keep what the robot learned.'),
    )


def allowed(view: LessonView) -> frozenset[str]:
    """Say which commands make sense now; the session checks again.

    Args:
        view: What is known.

    Returns:
        Names of commands of the table in console/commands.py.
    """
    if view.busy:
        return frozenset({"stop"})
    names = {"stop", "reset"} if view.phase is not Phase.WAITING else {"stop"}
    if view.has_model:
        names.add("save")
    if view.mode is TeachingMode.STOPPED:
        return frozenset(names)
    names |= {Phase.READY: {"start_demonstration", "run"}, Phase.DEMONSTRATING: {"finish_demonstration"},
              Phase.PAUSED: {"run"}}.get(view.phase, set())
    if view.phase is Phase.READY and view.has_model:
        names.add("ask")
    if view.phase in (Phase.READY, Phase.FAULT, Phase.PAUSED):
        names |= {"undo"} if any(not item.taken_back for item in view.items) else set()
        names |= {"redo"} if any(item.taken_back for item in view.items) else set()
    if view.phase not in (Phase.WAITING, Phase.READY, Phase.PAUSED, Phase.FAULT):
        names.add("pause")
    if view.phase is Phase.ASKING and view.question is not None and not view.question.answered:
        names |= {"answer_a", "answer_b", "answer_equal", "answer_neither"}
    return frozenset(names)


def refusal(view: LessonView, command: str, holder: str, *, in_control: bool) -> str:
    """Say why a command is not carried out; empty if it is. What ends motion is never refused.

    Args:
        view: What is known.
        command: Name of the command.
        holder: Who has control if not this one; empty: nobody.
        in_control: True if the command comes from the one in control.
    """
    if command in ALWAYS:
        return ""
    if not in_control:
        return f'{watching(holder)} Press "Take control" to teach from here.'
    return "" if command in allowed(view) else f"Not now: {COMMANDS[command].hint}"


def watching(holder: str) -> str:
    """Say what one does who has no control; holder is who has it, empty for nobody."""
    return f"You are watching: {holder} has control." if holder else "You are watching: nobody has control yet."
