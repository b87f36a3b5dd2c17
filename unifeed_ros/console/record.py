"""The list of what was taught, as the page keeps it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from unifeed_ros.console.motions import DrawnMotion, describe_change, drawn
from unifeed_ros.console.state import KINDS, Taught
from unifeed_ros.core.feedback.items import Correction, Demonstration, FeedbackItem
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array

NUMBERS = {word: number for number, word in KINDS.items()}


class TaughtRecord:
    """Inputs in the order in which they came; those taken back stay in the list, so that they can be given back.

    Args:
        robot: The arm that is taught.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._robot = robot
        self._items: dict[str, Taught] = {}
        self._planned: DrawnMotion | None = None

    @property
    def items(self) -> tuple[Taught, ...]:
        """The list, oldest first."""
        return tuple(self._items.values())

    def newest(self, *, taken_back: bool) -> str:
        """Give the name of the newest input that counts, or of the newest that was taken back; empty for none."""
        return next((item.id for item in reversed(self.items) if item.taken_back == taken_back), "")

    def add(self, item: FeedbackItem) -> None:
        """Note an input; one that came before under this name counts again."""
        self._items[item.id] = Taught(id=item.id, kind=NUMBERS[item.kind], paths=self._paths(item),
                                      change=self._items[item.id].change if item.id in self._items else "")

    def keep_only(self, ids: Collection[str]) -> None:
        """Take the learner's word for which inputs count."""
        self._items = {name: replace(item, taken_back=name not in ids) for name, item in self._items.items()}

    def trust(self, weights: Mapping[int, float]) -> None:
        """Note how far each kind was trusted in the newest model, by the kind's number, 0 to 1 [1]."""
        self._items = {name: replace(item, reliability=weights[item.kind]) for name, item in self._items.items()}

    def planned(self, plan: DrawnMotion, ids: Sequence[str]) -> str:
        """Note the plan that came of some inputs.

        Args:
            plan: The new plan.
            ids: Names of the inputs; none after an undo.

        Returns:
            What it changed, as a sentence.
        """
        change = describe_change(self._planned, plan)
        self._planned = plan
        for name in ids:
            if name in self._items:
                self._items[name] = replace(self._items[name], change=change)
        return change

    def _paths(self, item: FeedbackItem) -> tuple[Array, ...]:
        """Give the tool paths of the small drawing, the wanted one first."""
        if isinstance(item, Demonstration):
            motions = [item.trajectory]
        elif isinstance(item, Correction):
            motions = [item.corrected, item.planned]
        else:
            order = np.argsort(item.ranks, kind="stable") if item.ranks else range(len(item.options))
            motions = [item.options[k] for k in order]
        return tuple(drawn(self._robot, motion).path for motion in motions)
