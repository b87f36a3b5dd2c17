"""The page as a whole: serves it, checks what is pressed, draws what is known."""

from __future__ import annotations

from typing import Protocol

import numpy as np
import viser
from viser._messages import ShareUrlDisconnect, ShareUrlRequest

from unifeed_ros.console.access import Gate, Holder, choose_token, guarded, is_loopback
from unifeed_ros.console.commands import COMMANDS, TAKE
from unifeed_ros.console.drawing import as_text, grid_states, reward_colours
from unifeed_ros.console.motions import DrawnMotion, rewards_along
from unifeed_ros.console.panel import IN_TURN, NO_PAST, STILL, LessonPanel, Look
from unifeed_ros.console.scene import SLICE_HIGH, SLICE_LOW, LessonScene
from unifeed_ros.console.state import LessonView, Phase, refusal, watching
from unifeed_ros.core.modes import Control
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.scene import Scene
from unifeed_ros.core.types import Array

SLICE_POINTS = 48
"""Points along each side of the slice of the reward."""
REST_S = 0.7
"""Time that ghosts stand at the end of their motion [s]."""
BEFORE, PAST = (110, 60, 130), (40, 44, 50)
CONTACT, HAND_BACK, QUESTION = (660.0,), (660.0, 440.0), (520.0, 660.0, 780.0)
"""Tones of the sounds [Hz]."""


class Teacher(Protocol):
    """What the page asks of the node behind it."""

    def press(self, command: str, item: str) -> None:
        """Carry a command of the table out; item is what it is about, or empty."""

    def pull(self, target: Array | None) -> None:
        """Pull the arm's hand towards a place, shape (3,) [m]; None lets go."""

    @property
    def in_control(self) -> bool:
        """True while the pages have control of the lesson, and no terminal."""

    def take_control(self) -> None:
        """Take control of the lesson for the pages."""


class TeachingPage:
    """The page of one lesson; every method may be called from any thread.

    Args:
        robot: The arm.
        scene: The task.
        teacher: What carries commands out.
        host: Address to listen on.
        port: Port to listen on; the next free one is taken.
        token: Token that a page must show; empty: one is chosen where other machines could reach the page.
        pullable: True if the mouse may pull the arm's hand.
        coarse: True: coarse meshes and no shadows.

    Raises:
        ConfigError: The address cannot be listened on, or the URDF lacks a mesh.
    """

    def __init__(self, robot: RobotModel, scene: Scene, teacher: Teacher, *, host: str, port: int, token: str,
                 pullable: bool, coarse: bool = False) -> None:
        self._context, self._scene_of_task, self._teacher = scene.context(), scene, teacher
        self.token = choose_token(host, token)
        with guarded(Gate(self.token, local=is_loopback(host))):
            self._server = viser.ViserServer(host=host, port=port, verbose=False)
        self._refuse_sharing()
        self._host = host
        self._holder, self._view = Holder(), LessonView()
        self._puller: int | None = None
        self._control: tuple[bool, str] = (False, "")
        self._pages: dict[int, tuple[viser.GuiHtmlHandle, viser.GuiButtonHandle]] = {}
        self._plan: DrawnMotion | None = None
        self._before: DrawnMotion | None = None
        self._past: dict[str, DrawnMotion] = {}
        self._options: dict[str, DrawnMotion] = {}
        self._model: RewardEnsemble | None = None
        self._drawn_look: tuple[object, ...] = ()
        self._scene = LessonScene(self._server, robot, scene, pullable=pullable, coarse=coarse)
        self._scene.on_pull(self._on_pull)
        self._panel = LessonPanel(self._server, self._on_press, scene.floor)
        self._server.on_client_connect(self._on_open)
        self._server.on_client_disconnect(self._on_close)

    @property
    def address(self) -> str:
        """Address to open in a browser, with the token where one is needed."""
        name = "localhost" if self._host in ("0.0.0.0", "::") else self._host
        name = f"[{name}]" if ":" in name else name
        return f"http://{name}:{self._server.get_port()}/" + (f"?token={self.token}" if self.token else "")

    @property
    def watched(self) -> bool:
        """True while a page is open."""
        return bool(self._pages)

    def close(self) -> None:
        """End the server."""
        self._server.stop()

    # What the node shows.

    def show(self, view: LessonView) -> None:
        """Bring everything but the arm up to date."""
        before, self._view = self._view, view
        self._panel.show(view)
        self._make_sound(before, view)
        if view.phase is not Phase.ASKING and self._options:
            self.show_options({})
        self._draw_look(self._panel.look)

    def show_control(self, held: bool, other: str) -> None:
        """Say whether the pages have control of the lesson, and which terminal has it otherwise (empty: none)."""
        if (held, other) != self._control:
            self._control = (held, other)
            if not held:
                self._let_go_of(self._puller)
            self._show_holder()

    def move_arm(self, positions: Array) -> None:
        """Show the arm's posture, shape (n,) [rad]."""
        self._scene.move_arm(positions)

    def show_model(self, model: RewardEnsemble) -> None:
        """Colour what is drawn by a new reward."""
        self._model = model
        self._draw_plan()

    def show_plan(self, plan: DrawnMotion) -> None:
        """Draw a new plan; the one so far becomes the plan before."""
        self._before, self._plan = self._plan, plan
        self._draw_plan()

    def add_past(self, name: str, motion: DrawnMotion) -> None:
        """Offer a motion that the arm has carried out."""
        self._past[name] = motion
        self._panel.show_past(tuple(self._past))

    def show_options(self, options: dict[str, DrawnMotion]) -> None:
        """Draw the motions of a question; an empty one ends it."""
        self._options = options
        self._scene.show_options(options)

    def animate(self, time: float) -> None:
        """Move the ghosts of a question.

        Args:
            time: Any steady time [s].
        """
        play = self._panel.look.play
        if not self._options or play == STILL:
            return
        lengths = {name: motion.duration + REST_S for name, motion in self._options.items()}
        now = time % (sum(lengths.values()) if play == IN_TURN else max(lengths.values()))
        for name, motion in self._options.items():
            shown = 0.0 <= now < lengths[name] or play != IN_TURN
            share = min(max(now, 0.0) / motion.duration, 1.0)
            posture = motion.positions[round(share * (len(motion.positions) - 1))]
            self._scene.move_ghost(name, posture if shown else None)
            now -= lengths[name] if play == IN_TURN else 0.0

    def tell(self, message: str) -> None:
        """Show a short note on every page."""
        for client in self._server.get_clients().values():
            client.add_notification("Teach the robot", message, auto_close_seconds=6.0)

    # What a person does.

    def _on_press(self, command: str, item: str, page: int | None) -> None:
        if command not in COMMANDS:
            return
        if command == TAKE.name:
            self._take(page)
        elif reason := refusal(self._view, command, self._whoever(),
                               in_control=self._holder.may(page) and self._teacher.in_control):
            self._tell_one(page, reason)
        else:
            self._teacher.press(command, item)

    def _take(self, page: int | None) -> None:
        if page is not None:
            self._let_go_of(self._holder.holder)
            self._holder.take(page)
            self._teacher.take_control()
            self._show_holder()

    def _on_pull(self, phase: str, page: int, target: Array | None) -> None:
        if phase == "start" and self._holder.may(page) and self._teacher.in_control:
            self._puller = page
        if page == self._puller:
            self._teacher.pull(target if target is not None and np.isfinite(target).all() else None)
            if phase == "end":
                self._puller = None

    async def _on_open(self, client: viser.ClientHandle) -> None:
        self._holder.open(client.client_id)
        line = client.gui.add_html("", order=-2.0)
        take = client.gui.add_button(TAKE.label, color=TAKE.color, hint=TAKE.hint, order=-1.0)

        @take.on_click
        async def _(_: viser.GuiEvent) -> None:
            self._take(client.client_id)

        self._pages[client.client_id] = (line, take)
        self._show_holder()

    async def _on_close(self, client: viser.ClientHandle) -> None:
        self._let_go_of(client.client_id)
        self._pages.pop(client.client_id, None)
        self._holder.close(client.client_id)
        self._show_holder()

    def _let_go_of(self, page: int | None) -> None:
        """Let the hand go if this page pulls it."""
        if page is not None and page == self._puller:
            self._puller = None
            self._teacher.pull(None)

    def _whoever(self) -> str:
        """Name who has control, for a page that has not; as plain text."""
        held, other = self._control
        return "another page" if held else other

    def _show_holder(self) -> None:
        for page, (line, take) in list(self._pages.items()):
            holds = page == self._holder.holder and self._control[0]
            words = "You teach from this page." if holds else watching(as_text(self._whoever()))
            line.content = f'<div style="padding:4px 12px;font-family:sans-serif;font-size:14px">{words}</div>'
            take.visible = not holds

    def _tell_one(self, page: int | None, message: str) -> None:
        client = self._server.get_clients().get(page) if page is not None else None
        if client is not None:
            client.add_notification("Not done", message, auto_close_seconds=5.0)

    # Drawing.

    def _draw_plan(self) -> None:
        if self._plan is not None:
            self._scene.show_plan(self._plan, *rewards_along(self._model, self._plan, self._context))

    def _draw_look(self, look: Look) -> None:
        """Draw what the person chose, if the choice or what it shows has changed."""
        version = self._model.version if self._model is not None else 0
        wanted = (look.before, look.past, look.slice, look.height, version, id(self._before))
        if wanted == self._drawn_look:
            return
        self._drawn_look = wanted
        self._scene.show_line("/before", self._before if look.before else None, BEFORE)
        self._scene.show_line("/past", self._past.get(look.past) if look.past != NO_PAST else None, PAST)
        picture = None
        if look.slice and self._model is not None:
            states = grid_states(SLICE_LOW, SLICE_HIGH, look.height, self._scene_of_task.axis, SLICE_POINTS)
            rewards = self._model.member_rewards(states, self._context).mean(axis=0)
            picture = reward_colours(rewards.reshape(SLICE_POINTS, SLICE_POINTS))
        self._scene.show_slice(picture, look.height)

    def _make_sound(self, before: LessonView, view: LessonView) -> None:
        if view.phase is Phase.ASKING and before.phase is not Phase.ASKING:
            self._panel.play_sound(QUESTION)
        elif view.control is Control.PERSON and before.control is not Control.PERSON:
            self._panel.play_sound(CONTACT)
        elif before.control is Control.PERSON and view.control is not Control.PERSON:
            self._panel.play_sound(HAND_BACK)

    def _refuse_sharing(self) -> None:
        """Leave out viser's offer to publish the page through a server of its makers."""
        for kind in (ShareUrlRequest, ShareUrlDisconnect):
            self._server._websock_server.unregister_handler(kind)
