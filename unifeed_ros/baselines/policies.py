"""Policies instead of rewards: human-gated BC, AIRL and Atari, trained in another environment, followed by the arm.

The trainers are those of the libraries imitation and stable-baselines3, which want other versions than this package:
`make policies` gives them an environment of their own, and `policy_worker.py` runs there. docs/methods.md has the
values, and where each method departs from its source.
"""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from unifeed_ros.core.errors import ConfigError, InputError, TrainingError
from unifeed_ros.core.feedback.items import Correction, Demonstration, FeedbackItem, Preference
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, Trajectory

PYTHON_VARIABLE = "UNIFEED_POLICIES_PYTHON"
"""Environment variable with the Python interpreter of the libraries' environment, where it is not the usual one."""
_WORKER = Path(__file__).with_name("policy_worker.py")
USUAL_PYTHON = Path(__file__).resolve().parents[2] / ".venv-policies" / "bin" / "python"
"""What `make policies` makes."""
_DAMPING = 1e-3
"""Damping of the joint displacements that follow the tool's path [m^2]."""
_ROOM = 1.25
"""Largest step of a policy over the largest one that was shown [1]."""
_MARGIN = 0.1
"""How far from the box of what was shown a policy may move the tool, in each direction [m]."""


@dataclass(frozen=True, kw_only=True)
class CloningConfig:
    """Human-gated behaviour cloning."""

    epochs: int = 300
    """Times that training goes through what was shown."""
    batches: int = 3
    """Batches in which it does so each time."""
    learning_rate: float = 1e-3
    """Of Adam."""
    entropy: float = 1e-3
    """Weight of the policy's entropy."""


@dataclass(frozen=True, kw_only=True)
class AdversarialConfig:
    """AIRL with PPO."""

    rounds: int = 10
    """Rounds of policy and discriminator."""
    tools: int = 16
    """Motions that are carried out at once."""
    motions: int = 4
    """Motions of each in a round."""
    epochs: int = 10
    """Times that PPO goes through a round's motions."""
    discriminator_epochs: int = 10
    """Steps of the discriminator in a round."""
    batch: int = 256
    """Batch of PPO."""
    learning_rate: float = 1e-3
    """Of PPO and of the discriminator."""
    discount: float = 0.995
    """Discount gamma, also of the shaping."""
    entropy: float = 0.0
    """Weight of the policy's entropy."""
    log_std: float = -2.0
    """Logarithm of the policy's standard deviation at the start, of a share of the largest step."""
    clone: int = 100
    """Times that cloning goes through the demonstrations before the rounds begin; 0: they begin at random."""


@dataclass(frozen=True, kw_only=True)
class AtariConfig:
    """Demonstrations and preferences with reinforcement learning."""

    cloning: CloningConfig = CloningConfig(epochs=100)
    """Of the policy whose motions are asked about."""
    automatic: int = 4
    """Motions of that policy that each demonstration is ranked over without asking."""
    reward_epochs: int = 100
    """Times that the reward's training goes through the rankings."""
    steps: int = 600
    """Steps of the tools while SAC trains."""
    tools: int = 8
    """Motions that are carried out at once."""
    learning_rate: float = 1e-4
    """Of SAC."""
    entropy: float = 0.01
    """Weight of the policy's entropy at the start; SAC goes on to fit it. From 1, its own, the clone is soon lost."""
    discount: float = 0.99
    """Discount gamma."""
    clone: int = 2000
    """Steps that bring SAC's policy to the demonstrations before it begins."""


PolicyConfig: TypeAlias = CloningConfig | AdversarialConfig | AtariConfig
"""Settings of one of the methods."""


class Worker:
    """The other environment's process, which trains one policy after the other. Use as a context manager."""

    def __init__(self, python: Path | None = None) -> None:
        """Begin without the process: it is started when it is first needed.

        Args:
            python: Interpreter of the libraries' environment; None: that of `make policies`.
        """
        self._python = python or Path(os.environ.get(PYTHON_VARIABLE, USUAL_PYTHON))
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> Worker:
        """Nothing to do yet."""
        return self

    def __exit__(self, *_: object) -> None:
        """End the process."""
        if self._process is not None:
            self._process.communicate()
            self._process = None

    def _started(self) -> subprocess.Popen[str]:
        if self._process is None:
            if not self._python.is_file():
                raise ConfigError("environment of the libraries imitation and stable-baselines3", got="no such file",
                                  expected=str(self._python),
                                  mend=f"`make policies`, or name its Python in {PYTHON_VARIABLE}")
            env = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONHOME")}
            self._process = subprocess.Popen(
                [str(self._python), "-P", str(_WORKER)], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL, text=True, env={**env, "OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": ""})
        return self._process

    def train(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Let it train a policy.

        Args:
            request: As `policy_worker.answer` wants it.

        Returns:
            Its answer.

        Raises:
            ConfigError: The libraries' environment is missing.
            TrainingError: Training failed, or the process ended.
        """
        process = self._started()
        assert process.stdin is not None and process.stdout is not None
        try:
            process.stdin.write(json.dumps(request) + "\n")
            process.stdin.flush()
            line = process.stdout.readline()
        except BrokenPipeError:
            line = ""
        answer: dict[str, Any] = json.loads(line) if line else {"error": "the process ended (packages missing?)"}
        if "error" in answer:
            raise TrainingError(f"a policy by {request['method']}", got=answer["error"],
                                mend="`make policies` makes its environment anew")
        return answer


class PolicyLearner:
    """Trains a policy on what was taught, and turns what it does into a motion of the arm.

    Attributes:
        seconds: Processor time that training took in the other process so far [s].
    """

    def __init__(self, method: str, worker: Worker, robot: RobotModel, start: Array, duration: float, waypoints: int,
                 config: PolicyConfig, seed: int, lowest: float = 0.0) -> None:
        """Start without a policy.

        Args:
            method: "BC", "AIRL" or "Atari".
            worker: Trains.
            robot: The arm that is taught.
            start: Joint positions at the start of a motion, shape (n,) [rad].
            duration: Duration of a motion [s].
            waypoints: States H of a motion; a policy makes H - 1 steps.
            config: Settings of the method.
            seed: Seed of the training.
            lowest: Least height of the tool [m].
        """
        self._lowest = lowest
        self._method, self._worker, self._robot, self._config, self._seed = method, worker, robot, config, seed
        self._start, self._duration, self._waypoints = start, duration, waypoints
        self._items: list[FeedbackItem] = []
        self._sampled: list[Any] = []
        self.seconds = 0.0

    def learn(self, item: FeedbackItem) -> None:
        """Take an input for the next training.

        Args:
            item: What was taught.
        """
        self._items.append(item)

    def motion(self) -> Trajectory:
        """Train on everything that was taught, and follow the policy.

        Returns:
            What the arm does with it.

        Raises:
            InputError: No demonstration was given.
            TrainingError: Training failed.
        """
        extra: dict[str, Any] = {}
        if isinstance(self._config, AtariConfig):
            self._require_samples()
            pairs = [(item.options[better], item.options[worse]) for item in self._items
                     if isinstance(item, Preference) for better, worse in item.ranked_pairs]
            extra = {"sampled": self._sampled,
                     "ranked": [[self._path(better).tolist(), self._path(worse).tolist()] for better, worse in pairs]}
        return self._followed(self._trained(self._method, self._config, 0, extra)["motion"])

    def question(self) -> tuple[Trajectory, ...]:
        """Give two motions of the policy that was cloned from the demonstrations, drawn at random."""
        self._require_samples()
        asked = 2 * sum(isinstance(item, Preference) for item in self._items)
        return tuple(self._followed(path) for path in self._sampled[asked:asked + 2])

    def _require_samples(self) -> None:
        if not self._sampled:
            assert isinstance(self._config, AtariConfig)
            self._sampled = self._trained("BC", self._config.cloning, 16, {})["samples"]

    def _trained(self, method: str, config: Any, samples: int, extra: Mapping[str, Any]) -> dict[str, Any]:
        shown = [self._path(item.trajectory) for item in self._items if isinstance(item, Demonstration)]
        if not shown:
            raise InputError(f"what {method} learns from", expected="a demonstration first", got="none")
        spans = [self._span(item) for item in self._items if isinstance(item, Correction)]
        largest = _ROOM * max(float(np.abs(np.diff(path, axis=0)).max()) for path in shown)
        whole = np.concatenate(shown)
        box = whole.min(axis=0) - _MARGIN, whole.max(axis=0) + _MARGIN
        box[0][2] = max(box[0][2], self._lowest)
        answer = self._worker.train({
            "box": [corner.tolist() for corner in box],
            "method": method, "seed": self._seed, "start": self._robot.tool_states(self._start[None])[0, :3].tolist(),
            "steps": self._waypoints - 1, "largest": largest, "samples": samples, "settings": asdict(config),
            "demonstrations": [path.tolist() for path in shown],
            "interventions": [{"path": path.tolist(), "passed": passed} for path, passed in spans], **extra})
        self.seconds += answer["seconds"]
        return answer

    def _path(self, motion: Trajectory) -> Array:
        """Give the tool's positions at H evenly timed states of a motion, shape (H, 3) [m]."""
        return np.asarray(self._robot.tool_states(motion.resampled(self._waypoints))[:, :3])

    def _span(self, item: Correction) -> tuple[Array, int]:
        """Give the tool's positions at those of the H states that a correction spans, and the first one's number."""
        step = self._duration / (self._waypoints - 1)
        first, last = int(np.ceil(item.span[0] / step - 1e-9)), int(np.floor(item.span[1] / step + 1e-9))
        times = item.corrected.times[0] + step * np.arange(first, last + 1) - item.span[0]
        return np.asarray(self._robot.tool_states(item.corrected.positions_at(times))[:, :3]), first

    def _followed(self, path: Sequence[Sequence[float]]) -> Trajectory:
        positions = follow(self._robot, self._start, np.asarray(path), self._duration)
        return Trajectory(joint_names=self._robot.joint_names, positions=positions,
                          times=np.linspace(0.0, self._duration, len(positions)))


def follow(robot: RobotModel, start: Array, path: Array, duration: float, iterations: int = 5) -> Array:
    """Follow positions of the tool with the arm, its direction kept, within the limits of position and velocity.

    Args:
        robot: The arm.
        start: Joint positions at the start, shape (n,) [rad].
        path: Evenly timed positions of the tool, shape (H, 3) [m].
        duration: Time from first to last [s].
        iterations: Newton steps at each.

    Returns:
        Joint positions, shape (H, n) [rad]; the tool is where the limits let it be.
    """
    axis = robot.tool_states(start[None])[0, 3:]
    reach = robot.velocity_limits * duration / (len(path) - 1)
    followed = [start]
    for position in path[1:]:
        before = followed[-1]
        lower, upper = np.maximum(robot.lower, before - reach), np.minimum(robot.upper, before + reach)
        q = before
        for _ in range(iterations):
            states, jacobians = robot.tool_states_and_jacobians(q[None])
            error, jacobian = np.concatenate([position, axis]) - states[0], jacobians[0]
            q = np.clip(q + jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + _DAMPING * np.eye(6), error),
                        lower, upper)
        followed.append(q)
    return np.stack(followed)
