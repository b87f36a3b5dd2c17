"""The energy account: seen from the hand, the arm gives no more than it was given, its store, and what the supply gave.

The supply is open only while nobody touches; a hand below its level counts as the motion's own friction does.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))
from control_loop import ROBOTS, Loop

from unifeed_ros.core.control.energy import EnergyAccount
from unifeed_ros.core.control.settings import ControlConfig
from unifeed_ros.core.errors import ConfigError

CONFIG = ControlConfig()
TOLERANCE = 0.1
"""Energy that commands 3 ms late and the noise of the sensors may add [J]."""
INSENSITIVE = {"yield_start": 20.0, "yield_full": 40.0}
"""An arm that hardly yields: only the account is left."""


@given(st.lists(st.tuples(st.floats(-5.0, 5.0), st.floats(0.0, 0.1)), max_size=50))
def test_books_balance_and_the_level_never_exceeds_the_store(periods):
    account, given_back = EnergyAccount(CONFIG), 0.0
    for spent, supplied_for in periods:
        account.settle(spent, supplied_for)
        given_back += spent
        assert account.level <= CONFIG.energy_store + 1e-12
        assert given_back <= CONFIG.energy_store + account.supplied - account.level + 1e-9
        assert 0.0 <= account.share <= 1.0


def test_the_share_shrinks_with_the_store_and_the_supply_brings_it_back():
    account = EnergyAccount(CONFIG)
    account.settle(CONFIG.energy_store - 0.5 * CONFIG.energy_low, 0.0)
    assert account.share == pytest.approx(0.5)
    account.settle(CONFIG.energy_low, 0.0)
    assert account.share == 0.0 and account.supplied == 0.0
    account.settle(0.0, 100.0)
    assert account.share == 1.0 and account.level == CONFIG.energy_store


def test_a_low_mark_above_the_store_is_refused():
    with pytest.raises(ConfigError, match="energy_low"):
        ControlConfig(energy_store=0.2)


class Meter:
    """Measures at the hand: what the arm gave beyond what it was given and what the supply gave, at most so far."""

    def __init__(self, loop):
        self.loop, self.work, self.most = loop, 0.0, 0.0
        arm, account = loop.arm, loop.controller.account
        inertia = pin.crba(loop.robot.pin_model, loop.robot.pin_model.createData(), arm.true_positions)
        inertia += 0.1 * np.eye(loop.robot.n)  # rotors of the simulated arm
        self.began = account.supplied
        self.bound = account.level + 0.5 * arm.true_velocities @ inertia @ arm.true_velocities + TOLERANCE

    def run(self, seconds, hand):
        arm, controller = self.loop.arm, self.loop.controller
        for _ in range(round(seconds * 1000)):
            jacobian = self.loop.robot.tool_jacobian(arm.true_positions)[:3]
            force = hand(jacobian @ arm.true_velocities)
            arm.push([*force, 0.0, 0.0, 0.0])
            before = arm.true_positions
            self.loop.step()
            self.work += float((force @ jacobian) @ (arm.true_positions - before))
            self.most = max(self.most, -self.work - (controller.account.supplied - self.began))


def limited(force, most=30.0):
    size = np.linalg.norm(force)
    return force if size <= most else force * (most / size)


@pytest.mark.parametrize(("name", "seed", "track", "impedance"), [
    ("panda", 1, True, "joint"), ("panda", 2, True, "joint"), ("panda", 3, False, "joint"), ("ur10", 4, True, "joint"),
    ("ur10", 5, False, "joint"), ("panda", 6, True, "tool"), ("ur10", 7, False, "tool")])
def test_any_push_sequence_extracts_at_most_the_store(name, seed, track, impedance):
    rng = np.random.default_rng(seed)
    loop = Loop(ROBOTS[name], impedance=impedance, **(INSENSITIVE if seed % 2 else {}))
    if track:
        loop.start_tracking(duration=4.0)
    else:
        loop.controller.hold(loop.arm.state())
    loop.run(1.0)
    meter = Meter(loop)
    for _ in range(8):
        push, drag = rng.uniform(0.0, 30.0) * unit(rng), rng.choice([0.0, 30.0, 200.0])
        meter.run(rng.uniform(0.1, 0.8), lambda v, push=push, drag=drag: limited(push - drag * v))
    assert meter.work > 0.5 or meter.most > 0.1  # something was exchanged
    assert meter.most <= meter.bound
    assert np.isfinite(loop.arm.true_positions).all()


def unit(rng):
    direction = rng.normal(size=3)
    return direction / np.linalg.norm(direction)


@pytest.mark.parametrize("name", sorted(ROBOTS))
def test_a_hand_that_brakes_the_motion_gets_the_store_and_no_more(name):
    """The same hand gets many times the store from an arm without the account, so this can fail."""
    def braked(**config):
        loop = Loop(ROBOTS[name], **INSENSITIVE, **config)
        loop.start_tracking(duration=4.0)
        loop.run(0.4)
        meter = Meter(loop)
        meter.run(4.0, lambda v: limited(-200.0 * v))
        return meter

    assert braked(energy_store=1e6).most > 4.0 * CONFIG.energy_store
    with_account = braked()
    assert 0.5 * CONFIG.energy_store < with_account.most <= with_account.bound


def test_nothing_is_supplied_while_a_person_leads():
    loop = Loop(ROBOTS["panda"])
    loop.start_tracking(duration=6.0)
    loop.run(1.0)
    loop.run(0.2, (0.0, 20.0, 0.0))
    before = loop.controller.account.supplied
    loop.run(1.0, (0.0, 20.0, 0.0))
    assert loop.controller.account.supplied == before


def test_an_arm_that_spent_its_store_goes_on_when_it_is_let_go():
    loop = Loop(ROBOTS["panda"], **INSENSITIVE)
    motion = loop.start_tracking(duration=4.0)
    loop.run(0.4)
    Meter(loop).run(4.0, lambda v: limited(-200.0 * v))
    assert loop.commands[-1].authority < 0.9
    loop.run(motion.duration + 2.0)
    assert loop.commands[-1].finished
    assert loop.controller.account.level > 0.9 * CONFIG.energy_store
