"""Serves the teaching page: shows how the lesson stands, carries out what a person presses."""

from __future__ import annotations

import os
import sys
import threading
import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from geometry_msgs.msg import WrenchStamped

from unifeed_msgs.msg import TeachingState
from unifeed_ros.console.motions import DrawnMotion, drawn
from unifeed_ros.console.page import TeachingPage
from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.types import Array, Trajectory
from unifeed_ros.nodes.conversions import header, seconds
from unifeed_ros.nodes.lesson_node import LessonNode
from unifeed_ros.nodes.node import OK
from unifeed_ros.nodes.parameters import settings
from unifeed_ros.nodes.spin import run_node
from unifeed_ros.simulation.mouse_hand import MouseHand

if TYPE_CHECKING:
    from unifeed_ros.simulation.tasks import Yardstick

DRAW_PERIOD, VIEW_PERIOD = 0.03, 0.1
"""Time between two postures, and between two looks of the widgets [s]."""


@dataclass(frozen=True, kw_only=True)
class ConsoleConfig:
    """Where the page is, and what it may do."""

    host: str = "127.0.0.1"
    """Address to listen on; another than this machine's own asks for a token."""
    port: int = 8080
    """Port to listen on; the next free one is taken."""
    token: str = ""
    """Token that a page must show; empty: one is made up where other machines could reach the page."""
    coarse: bool = False
    """True: coarse meshes and no shadows, for tablets and machines without a graphics card."""
    pullable: bool = False
    """True: the mouse pulls the hand of the simulated arm."""
    true_reward: bool = False
    """True: a simulated person teaches, and the regret is shown."""

    def __post_init__(self) -> None:
        """Reject ports that are none."""
        if not 0 <= self.port <= 65535:
            raise ConfigError("port of the console", expected="0 to 65535", got=self.port)


class ConsoleNode(LessonNode):
    """Hand the page what is known ten times a second, carry its commands out."""

    def __init__(self) -> None:
        super().__init__("console", f"a page (console {os.getpid()})")
        self._config = settings(self, "console", ConsoleConfig)
        self._executed: list[Trajectory] = []
        self._yardstick: Yardstick | None = None
        self._mouse, self._target, self._pulling = MouseHand(self._robot), None, False
        self._used = time.process_time()
        self._page = TeachingPage(
            self._robot, self._scene, self, host=self._config.host, port=self._config.port, token=self._config.token,
            pullable=self._config.pullable, coarse=self._config.coarse)
        self._wrenches = self.advertise("hand_wrench") if self._config.pullable else None
        self.connect()
        self.create_timer(DRAW_PERIOD, self._draw, clock=self.steady)
        self.create_timer(VIEW_PERIOD, self._show, clock=self.steady)
        if self._config.true_reward:
            threading.Thread(target=self._measure, daemon=True).start()
        self.say(OK, f"teaching page: {self._page.address}", address=self._page.address)

    # What the page shows.

    def somebody_is_there(self) -> bool:
        """Say whether a page is open."""
        return self._page.watched

    def tell(self, message: str) -> None:
        """Show a note on every page."""
        super().tell(message)
        self._page.tell(message)

    def show_model(self, model: RewardEnsemble) -> None:
        """Colour what is drawn."""
        self._page.show_model(model)

    def show_plan(self, plan: DrawnMotion) -> None:
        """Draw the plan."""
        self._page.show_plan(plan)

    def show_executed(self, name: str, motion: Trajectory) -> None:
        """Offer the motion to look at, and keep it for the regret."""
        self._executed.append(motion)
        self._page.add_past(name, drawn(self._robot, motion))

    def show_options(self, options: dict[str, DrawnMotion]) -> None:
        """Draw ghosts."""
        self._page.show_options(options)

    def on_teaching(self, msg: TeachingState) -> None:
        """Answer the arm's state with the force of the mouse."""
        super().on_teaching(msg)
        self._pull_hand(msg)

    def _draw(self) -> None:
        if self._page.watched and len(self._teaching.positions) == self._robot.n:
            self._page.move_arm(np.asarray(self._teaching.positions))
            self._page.animate(time.monotonic())

    def _show(self) -> None:
        self._page.show_control(self.in_control, self.other)
        self._page.show(replace(self.view(), simulated=self._config.pullable,
                                taught_by_machine=self._config.true_reward, regret=self._regrets()))

    def _measure(self) -> None:
        from unifeed_ros.simulation.tasks import TrueTask, measure  # the planner is not needed where a person teaches

        self._yardstick = measure(self.load_robot(), TrueTask(scene=self._scene))

    def _regrets(self) -> tuple[float, ...]:
        if self._yardstick is None:
            return ()
        return tuple(self._yardstick.normalised_regret(motion) for motion in self._executed)

    # What the person does.

    def pull(self, target: Array | None) -> None:
        """Pull the arm's hand towards a place, shape (3,) [m]; None lets go."""
        self._target = target

    def _pull_hand(self, msg: TeachingState) -> None:
        """Answer the arm's state with the mouse's force, like a person who holds the hand."""
        target = self._target  # read once: the page's thread may let go meanwhile
        if self._wrenches is None or (target is None and not self._pulling):
            return
        wrench, now = np.zeros(6), seconds(msg.header.stamp)
        if target is not None:
            wrench = self._mouse.wrench(now, np.asarray(msg.positions), target)
        else:
            self._mouse.let_go()
        self._pulling = target is not None
        out = WrenchStamped(header=header(now, self._robot.config.base_frame))
        for part, values in ((out.wrench.force, wrench[:3]), (out.wrench.torque, wrench[3:])):
            part.x, part.y, part.z = map(float, values)
        self._wrenches.publish(out)

    def refresh_status(self) -> None:
        """Say where the page is and what it costs; the status comes once a second."""
        used, self._used = time.process_time() - self._used, time.process_time()
        self.say(OK, f"teaching page: {self._page.address}", address=self._page.address,
                 pages=int(self._page.watched), cpu_percent=f"{100 * used:.0f}")

    def close(self) -> None:
        """Let go of the arm's hand, give control back, end the page."""
        self._target = None
        if self._pulling:
            self._pull_hand(self._teaching)
        super().close()
        self._page.close()


def main() -> int:
    """Run the node `console`."""
    return run_node(ConsoleNode)


if __name__ == "__main__":
    sys.exit(main())
