"""The hand that a mouse moves, at the simulated arm in its weightless mode."""

from __future__ import annotations

import numpy as np

from unifeed_ros.simulation.hand import HandConfig
from unifeed_ros.simulation.mouse_hand import CLOSING_S, MOUSE_HAND, MouseHand


def test_it_closes_softly_and_is_never_stronger_than_a_person(panda):
    hand, q = MouseHand(panda), np.array(panda.config.seed)
    far = panda.tool_pose(q)[0] + [0.4, 0.0, 0.0]
    forces = [np.linalg.norm(hand.wrench(t, q, far)[:3]) for t in np.arange(0.0, 1.0, 0.01)]
    assert forces[0] == 0.0 and max(forces) <= MOUSE_HAND.largest_force + 1e-9
    assert (np.diff(forces) >= -1e-9).all() and forces[int(100 * CLOSING_S)] > 0.9 * MOUSE_HAND.largest_force
    hand.let_go()
    assert np.linalg.norm(hand.wrench(2.0, q, far)[:3]) == 0.0


def test_it_pulls_towards_the_place_and_against_speed(panda):
    hand, q = MouseHand(panda, HandConfig(push=0.0)), np.array(panda.config.seed)
    here = panda.tool_pose(q)[0]
    for t in np.arange(0.0, 0.5, 0.01):
        force = hand.wrench(t, q, here + np.array([0.0, 0.05, 0.0]))[:3]
    np.testing.assert_allclose(force, [0.0, 15.0, 0.0], atol=1e-6)  # 300 N/m
    moving = q + 0.01 * np.linalg.pinv(panda.tool_jacobian(q)[:3]) @ [0.0, 0.3, 0.0]
    slowed = hand.wrench(0.5, moving, panda.tool_pose(moving)[0])[:3]
    assert slowed[1] < 0.0
