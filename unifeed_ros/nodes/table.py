"""The one table of nodes, parameters and order that `unifeed up` and the launch files read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

Parameter = bool | int | float | str

RECORDER, CONSOLE = "recorder", "console"


@dataclass(frozen=True, kw_only=True)
class NodeSpec:
    """One process of a session."""

    executable: str
    """Name of the executable and of the node; its module is unifeed_ros.nodes.<executable>."""
    parameter_files: tuple[Path, ...]
    """YAML files, later ones win."""
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    """Single parameters, which win over the files."""
    remaps: tuple[str, ...] = ()
    """Names that change, as "from:=to"."""

    def arguments(self) -> list[str]:
        """Give the process arguments that carry the parameters."""
        words = ["--ros-args"]
        for path in self.parameter_files:
            words += ["--params-file", str(path)]
        for remap in self.remaps:
            words += ["-r", remap]
        for name, value in self.parameters.items():
            words += ["-p", f"{name}:={_yaml(value)}"]
        return words


@dataclass(frozen=True, kw_only=True)
class SessionSetup:
    """What a session is started with."""

    parameter_files: tuple[Path, ...]
    """Robot, task and session files, in this order."""
    simulated: bool = True
    """True: the simulated arm takes the place of the robot's driver."""
    taught_by: str = ""
    """Feedback of the simulated person as letters, for example "DDCCPP"; empty: no simulated person."""
    seed: int = 0
    """Seed of everything random."""
    speed: float = 1.0
    """Simulated seconds per second."""
    bag: Path | None = None
    """Folder of the recording, the learner keeps its inputs beside it, in `<bag>_taught`; None: nothing is kept."""
    console: bool = False
    """True: with the teaching page."""
    console_parameters: Mapping[str, Parameter] = field(default_factory=dict)
    """Parameters of the teaching page by name: host, port, token."""


def node_table(setup: SessionSetup) -> tuple[NodeSpec, ...]:
    """List the nodes of a session in the order in which they start.

    The recorder comes first, so that nothing is missed, and is the last to end.

    Args:
        setup: What the session is started with.

    Returns:
        The nodes.
    """
    rows: list[tuple[str, Mapping[str, Parameter]]] = []
    kept: dict[str, Parameter] = {} if setup.bag is None else {"learner.folder": f"{setup.bag}_taught"}
    if setup.bag is not None:
        rows.append((RECORDER, {"recorder.folder": str(setup.bag)}))
    if setup.simulated:
        rows.append(("sim_arm", {"simulation.seed": setup.seed, "simulation.speed": float(setup.speed)}))
    rows += [
        ("shared_control", {}),
        ("capture", {}),
        ("reward_learner", {"query.seed": setup.seed, **kept}),
        ("trajectory_optimizer", {}),
        ("session", {}),
    ]
    if setup.taught_by:
        rows.append(("sim_teacher", {"teacher.feedback": setup.taught_by, "teacher.seed": setup.seed}))
    if setup.console:
        pullable = setup.simulated and not setup.taught_by
        rows.append((CONSOLE, {"console.pullable": pullable, "console.true_reward": bool(setup.taught_by),
                               **{f"console.{name}": value for name, value in setup.console_parameters.items()}}))
    return tuple(NodeSpec(executable=name, parameter_files=setup.parameter_files, parameters=parameters)
                 for name, parameters in rows)


def _yaml(value: Parameter) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
