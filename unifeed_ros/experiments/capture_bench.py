"""How well contact is cut out of simulated pushes whose truth is known, and whether free motion stays free of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from unifeed_ros.core.capture.contact import ContactDetector
from unifeed_ros.core.capture.external_torque import MOMENTUM, WRENCH, ExternalTorqueConfig, make_converter
from unifeed_ros.core.capture.momentum import MomentumConfig
from unifeed_ros.core.capture.touches import Touch, TouchLog
from unifeed_ros.core.robot import RobotConfig, RobotModel
from unifeed_ros.core.types import Array
from unifeed_ros.simulation.arm import ArmConfig, SimulatedArm

WARM_UP = 10.0
"""Free motion before the first push: the first moves teach the detector the payload error [s]."""
NEAR = 0.05
"""Errors of onset and release up to this count as good [s]."""
WEAK = 5.0
"""Pushes below this may be missed or found [N]."""


@dataclass(frozen=True, kw_only=True)
class PushPlan:
    """What is done to the arm in one session."""

    seed: int
    """Seed of the arm's sensors, the motion and the pushes."""
    pushes: int
    """Number of pushes; with none the arm moves freely."""
    seconds: float = 0.0
    """Length of a session without pushes [s]."""
    hits: bool = False
    """True: short hard hits in place of pushes."""
    source: str = "joint_state"
    """Where external torque comes from, as in ExternalTorqueConfig."""


@dataclass(frozen=True)
class Push:
    """One push as it really was."""

    start: float
    """First moment of force [s]."""
    end: float
    """Last moment of force [s]."""
    force: tuple[float, float, float]
    """Largest force at the tool, base frame [N]."""
    ramp: float
    """Time in which the force rises, and in which it falls [s]."""

    def at(self, time: float) -> float:
        """Give the share of the largest force at a time."""
        ramp = min(1.0, (time - self.start) / self.ramp, (self.end - time) / self.ramp)
        return 0.5 - 0.5 * math.cos(math.pi * ramp) if ramp > 0.0 else 0.0

    @property
    def newton(self) -> float:
        """Size of the largest force [N]."""
        return float(np.linalg.norm(self.force))


def bench_capture(config: RobotConfig, *, pushes: int, minutes: float, hits: int, source: str, seed: int, jobs: int,
                  on_session: Callable[[str], None]) -> dict[str, Any]:
    """Push an arm that moves, let it move freely, hit it, and compare with what the detector says.

    Args:
        config: The arm; its model lacks a payload of 0.5 kg and misses a part of its friction.
        pushes: Number of pushes, 3 to 30 N, 0.15 to 5 s.
        minutes: Free motion [min].
        hits: Number of hits, 60 to 200 N for 15 to 40 ms.
        source: Where external torque comes from, as in ExternalTorqueConfig.
        seed: Seed of everything.
        jobs: Processes at once.
        on_session: Called with a line of progress.

    Returns:
        A summary, and a row for each range of force.
    """
    plans = [PushPlan(seed=seed + k, pushes=n, source=source) for k, n in enumerate(_parts(pushes, 50))]
    plans += [PushPlan(seed=seed + 1000 + k, pushes=0, seconds=s, source=source)
              for k, s in enumerate(_parts(round(60 * minutes), 300))]
    plans += [PushPlan(seed=seed + 2000 + k, pushes=n, hits=True, source=source)
              for k, n in enumerate(_parts(hits, 50))]
    judged = {}
    for plan, found in _sessions(config, plans, jobs):
        judged[plan] = found
        on_session(f"{len(judged)} of {len(plans)} sessions: {len(found[0])} pushes, {len(found[1])} contacts")
    pushed = [found for plan, found in judged.items() if plan.pushes and not plan.hits]
    free = [touch for plan, found in judged.items() if not plan.pushes for touch in found[1]]
    struck = [found for plan, found in judged.items() if plan.hits]
    matches = [match for truth, touches in pushed for match in match_pushes(truth, touches)]
    false = sum(len(unmatched(truth, touches)) for truth, touches in pushed)
    summary = {"robot": config.name, "source": source, **score(matches, false), "free_minutes": minutes,
               "false_contacts_free": len(free), **_hits(struck),
               "pushes_called_collisions": _share([not m[0].meant for p, m in matches if m and p.newton >= WEAK])}
    return {"summary": summary, "by_force": [_row(matches, low, high) for low, high in
                                             ((3.0, 5.0), (5.0, 7.0), (7.0, 10.0), (10.0, 20.0), (20.0, 30.0))]}


def _parts(total: int, most: int) -> list[int]:
    return [most] * (total // most) + ([total % most] if total % most else [])


def _sessions(config: RobotConfig, plans: list[PushPlan],
              jobs: int) -> Iterator[tuple[PushPlan, tuple[list[Push], list[Touch]]]]:
    if jobs == 1:
        yield from ((plan, run_session(config, plan)) for plan in plans)
        return
    with ProcessPoolExecutor(jobs) as pool:
        yield from zip(plans, pool.map(run_session, [config] * len(plans), plans), strict=True)


def run_session(config: RobotConfig, plan: PushPlan) -> tuple[list[Push], list[Touch]]:
    """Let one arm move among random postures and push it.

    Args:
        config: The arm.
        plan: What is done to it.

    Returns:
        The pushes as they were, and the touches found.
    """
    robot = RobotModel(config)
    rng = np.random.default_rng([plan.seed, 7])
    arm = SimulatedArm(robot, seed=plan.seed, table_height=None, config=ArmConfig(payload=0.5))
    pushes = make_pushes(plan, rng) if plan.pushes else []
    end = pushes[-1].end + 1.0 if pushes else plan.seconds
    motion = Wander(robot, rng)
    sense = make_sense(robot, arm, plan.source, rng)
    detector, log, waiting = ContactDetector(config.contact_thresholds, robot=robot), TouchLog(), list(pushes)
    while arm.time < end:
        arm.command(motion.torque(arm))
        if waiting and arm.time >= waiting[0].start:
            wrench = np.zeros(6)
            wrench[:3] = waiting[0].at(arm.time) * np.array(waiting[0].force)
            arm.push(wrench)
            if arm.time >= waiting[0].end:
                waiting.pop(0)
        arm.step()
        state = arm.state()
        torque = sense()
        if torque is not None:
            log.add(detector.update(state.time, torque, state.velocities, state.positions))
    return pushes, list(log.touches)


def make_pushes(plan: PushPlan, rng: np.random.Generator) -> list[Push]:
    """Draw pushes (or hits) with pauses of 1 to 2.5 s between them."""
    made, time = [], WARM_UP
    for _ in range(plan.pushes):
        direction = rng.normal(size=3)
        low, high, short, long = (60.0, 200.0, 0.015, 0.04) if plan.hits else (3.0, 30.0, 0.15, 5.0)
        force = math.exp(rng.uniform(math.log(low), math.log(high))) * direction / np.linalg.norm(direction)
        length = math.exp(rng.uniform(math.log(short), math.log(long)))
        ramp = 0.5 * length if plan.hits else rng.uniform(0.03, 0.06)
        made.append(Push(time, time + length, tuple(force.tolist()), ramp))
        time += length + rng.uniform(1.0, 2.5)
    return made


def make_sense(robot: RobotModel, arm: SimulatedArm, source: str,
               rng: np.random.Generator) -> Callable[[], Array | None]:
    """Build what measures external torque; the friction model of a drive is wrong, as in the arm's own estimate."""
    friction = tuple((np.array(robot.config.friction) * (1.0 + 0.15 * rng.normal(size=robot.n))).tolist())
    momentum = MomentumConfig(dry_friction=friction, viscous_friction=(0.5,) * robot.n, rotor_inertia=(0.1,) * robot.n,
                              friction_speed=0.005)
    convert = make_converter(robot, ExternalTorqueConfig(source=source, momentum=momentum))
    read = {WRENCH: arm.wrist_wrench, MOMENTUM: arm.measured_torque}.get(source, arm.external_torque)
    return lambda: convert(arm.state(), read())


class Wander:
    """Smooth motion from one random posture to the next, with pauses, held by joint impedance.

    Args:
        robot: The arm.
        rng: Where the postures come from.
    """

    def __init__(self, robot: RobotModel, rng: np.random.Generator) -> None:
        self._robot, self._rng = robot, rng
        self._from = self._to = np.array(robot.config.seed)
        self._stiffness, self._damping = np.array(robot.config.stiffness), np.array(robot.config.damping)
        self._start, self._length, self._pause = 0.0, 1.0, 0.0

    def torque(self, arm: SimulatedArm) -> Array:
        """Compute the torques that hold the arm on its way, shape (n,) [Nm]."""
        time = arm.time
        if time > self._start + self._length + self._pause:
            self._draw(time)
        s = min((time - self._start) / self._length, 1.0)
        way = self._to - self._from
        wanted = self._from + way * (s**3 * (10.0 - 15.0 * s + 6.0 * s**2))
        rate = way * (30.0 * s**2 * (1.0 - s) ** 2 / self._length)
        state = arm.state()
        return (self._robot.gravity(state.positions) + self._stiffness * (wanted - state.positions)
                + self._damping * (rate - state.velocities))

    def _draw(self, time: float) -> None:
        robot, rng = self._robot, self._rng
        wanted = np.array(robot.config.seed) + rng.uniform(-0.6, 0.6, robot.n)
        self._from, self._to = self._to, np.clip(wanted, robot.lower, robot.upper)
        fastest = float((np.abs(self._to - self._from) * 1.875 / robot.velocity_limits).max())
        self._start, self._length = time, max(fastest, 0.5) * rng.uniform(1.0, 2.0)
        self._pause = rng.uniform(0.0, 1.0)


def match_pushes(pushes: list[Push], touches: list[Touch]) -> list[tuple[Push, list[Touch]]]:
    """Give each push the touches that overlap it."""
    return [(push, [t for t in touches if t.onset < push.end and t.end > push.start]) for push in pushes]


def unmatched(pushes: list[Push], touches: list[Touch]) -> list[Touch]:
    """Give the touches that overlap no push."""
    return [t for t in touches if not any(t.onset < p.end and t.end > p.start for p in pushes)]


def score(matches: list[tuple[Push, list[Touch]]], false: int) -> dict[str, Any]:
    """Compute F1 and the errors of onset and release at 5 N and above; a push in pieces counts its pieces as false."""
    strong = [(push, found) for push, found in matches if push.newton >= WEAK]
    found = [(push, touches) for push, touches in strong if touches]
    extra = sum(len(touches) - 1 for _, touches in found) + false
    onsets = [touches[0].onset - push.start for push, touches in found]
    releases = [touches[-1].end - push.end for push, touches in found]
    total = 2 * len(found) + extra + (len(strong) - len(found))
    return {"pushes": len(matches), "pushes_5N": len(strong), "found_5N": len(found), "false_contacts": false,
            "in_pieces": extra - false, "f1": 2 * len(found) / total if total else None,
            **_errors("onset", onsets), **_errors("release", releases)}


def _errors(name: str, errors: list[float]) -> dict[str, Any]:
    if not errors:
        return {f"{name}_within_50ms": None, f"{name}_median_ms": None, f"{name}_p95_ms": None}
    size = np.abs(errors)
    return {f"{name}_within_50ms": float((size <= NEAR).mean()), f"{name}_median_ms": 1e3 * float(np.median(errors)),
            f"{name}_p95_ms": 1e3 * float(np.percentile(size, 95))}


def _hits(struck: list[tuple[list[Push], list[Touch]]]) -> dict[str, Any]:
    matches = [match for truth, touches in struck for match in match_pushes(truth, touches)]
    return {"hits": len(matches), "hits_found": _share([bool(m) for _, m in matches]),
            "hits_learned_from": _share([any(t.meant for t in m) for _, m in matches])}


def _row(matches: list[tuple[Push, list[Touch]]], low: float, high: float) -> dict[str, Any]:
    inside = [(p, m) for p, m in matches if low <= p.newton < high]
    figures = score([(replace(p, force=(WEAK, 0.0, 0.0)), m) for p, m in inside], 0)
    return {"force_N": [low, high], "pushes": len(inside), "found": figures["found_5N"],
            **{key: figures[key] for key in ("onset_within_50ms", "release_within_50ms", "in_pieces")}}


def _share(values: list[bool]) -> float | None:
    return sum(values) / len(values) if values else None
