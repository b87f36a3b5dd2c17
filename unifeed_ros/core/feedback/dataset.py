"""Everything that one robot was taught in a session: grows, never changes."""

from __future__ import annotations

from collections.abc import Sequence

from unifeed_ros.core.errors import InputError, TrainingError
from unifeed_ros.core.feedback.items import FeedbackItem, Preference


class FeedbackDataset:
    """Append-only log of feedback; undoing an item hides it, adding it again shows it in its old place.

    Attributes:
        robot: Robot that is taught.
        joint_names: Names of its joints, in order.
    """

    def __init__(self, robot: str, joint_names: Sequence[str]) -> None:
        """Start an empty dataset for one robot."""
        self.robot = robot
        self.joint_names = tuple(joint_names)
        self._log: dict[str, FeedbackItem] = {}
        self._undone: set[str] = set()

    @property
    def items(self) -> tuple[FeedbackItem, ...]:
        """The items that were not undone, in the order in which they were taught."""
        return tuple(item for item in self._log.values() if item.id not in self._undone)

    @property
    def undone(self) -> tuple[str, ...]:
        """Names of the items that were undone."""
        return tuple(name for name in self._log if name in self._undone)

    @property
    def counts(self) -> tuple[int, int, int]:
        """Number of demonstrations, corrections and preferences that were not undone."""
        letters = [item.letter for item in self.items]
        return letters.count("D"), letters.count("C"), letters.count("P")

    def comparisons(self) -> tuple[FeedbackItem, ...]:
        """The items that prefer one motion to another: all but rankings of "neither" or of ties alone.

        Raises:
            TrainingError: There is none, so nothing can be learned.
        """
        items = tuple(i for i in self.items if not isinstance(i, Preference) or i.ranked_pairs)
        if not items:
            raise TrainingError("nothing to learn from", expected="a demonstration, a correction or a ranking",
                                got=f"{len(self.items)} items without a comparison",
                                mend="teach the robot something first")
        return items

    def only(self, items: Sequence[FeedbackItem]) -> FeedbackDataset:
        """Give a dataset of some of the items, in the order given."""
        part = FeedbackDataset(self.robot, self.joint_names)
        for item in items:
            part.add(item)
        return part

    def add(self, item: FeedbackItem) -> None:
        """Append an item; one that was undone counts again as it was, where it was.

        Args:
            item: What was taught.

        Raises:
            InputError: It is of another robot, of other joints, or its name is in use.
        """
        if item.robot != self.robot:
            raise InputError(f"robot of {item.kind} {item.id}", expected=self.robot, got=item.robot)
        if item.joint_names != self.joint_names:
            raise InputError(f"joints of {item.kind} {item.id}", expected=self.joint_names, got=item.joint_names)
        if item.id in self._undone:
            self._undone.remove(item.id)
            return
        if item.id in self._log:
            raise InputError(f"{item.kind} {item.id} is already there", mend="give each item a name of its own")
        self._log[item.id] = item

    def undo(self, id: str | None = None) -> FeedbackItem:
        """Hide an item.

        Args:
            id: Name of the item; the last one by default.

        Returns:
            The item that was hidden.

        Raises:
            InputError: No such item is there.
        """
        items = {item.id: item for item in self.items}
        if not items:
            raise InputError("nothing to undo", mend="teach something first")
        name = id or next(reversed(items))
        if name not in items:
            raise InputError("no such feedback", expected=", ".join(items), got=name)
        self._undone.add(name)
        return items[name]
