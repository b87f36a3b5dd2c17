import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unifeed_ros.core.capture.external_torque import ExternalTorqueConfig, WrenchMapping, make_converter
from unifeed_ros.core.errors import ConfigError, InputError, ShapeError
from unifeed_ros.core.types import RobotState


def state(q, time=0.0):
    return RobotState(time=time, positions=np.asarray(q), velocities=np.zeros(len(q)))


def converter(robot, **settings):
    return make_converter(robot, ExternalTorqueConfig(**settings))


@given(st.integers(0, 1000))
def test_torque_of_a_wrench_does_the_same_work_in_the_tools_axes(panda, seed):
    rng = np.random.default_rng(seed)
    q = rng.uniform(panda.lower, panda.upper)
    wrench, dq = rng.normal(size=6), 1e-6 * rng.normal(size=panda.n)
    tau = converter(panda, source="wrench", tare_time=0.0)
    tau(state(q), np.zeros(6))  # an offset of zero
    torque = tau(state(q, 1.0), wrench)
    rotation = panda.tool_pose(q)[1]
    moved = rotation.T @ (panda.tool_pose(q + dq)[0] - panda.tool_pose(q - dq)[0])
    turned = rotation.T @ panda.tool_pose(q + dq)[1] @ panda.tool_pose(q - dq)[1].T @ rotation
    angle = 0.5 * np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]])
    assert torque @ (2 * dq) == pytest.approx(wrench[:3] @ moved + wrench[3:] @ angle, abs=1e-11)


def test_wrench_at_another_frame_is_the_same_wrench_moved_there(panda):
    q = np.array(panda.config.seed)
    tool, flange = (WrenchMapping(panda, frame, 0.0) for frame in ("panda_hand_tcp", "panda_link8"))
    for mapping in (tool, flange):
        mapping.torque(state(q), np.zeros(6))
    # the flange is turned by 45 degrees about z and 0.1034 m behind the tool
    c, s = np.cos(-np.pi / 4), np.sin(-np.pi / 4)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    force = np.array([3.0, -2.0, 5.0])
    at_flange = np.concatenate([turn @ force, np.cross([0.0, 0.0, 0.1034], turn @ force)])
    at_tool = np.concatenate([force, np.zeros(3)])
    np.testing.assert_allclose(flange.torque(state(q, 1.0), at_flange), tool.torque(state(q, 1.0), at_tool), atol=1e-3)


def test_tare_takes_the_sensors_offset_off_in_its_own_axes(panda):
    rng = np.random.default_rng(0)
    offset = np.array([4.0, -2.0, 1.0, 0.2, -0.1, 0.3])
    tau = converter(panda, source="wrench", tare_time=0.3)
    answers = [tau(state(panda.config.seed, 0.002 * k), offset + 0.2 * rng.normal(size=6)) for k in range(151)]
    assert answers[:150] == [None] * 150
    push = np.array([0.0, 0.0, 10.0, 0.0, 0.0, 0.0])
    turned = np.array(panda.config.seed) + np.array([1.0, 0.3, 0.0, 0.4, 0.5, 0.3, -1.0])
    ideal = converter(panda, source="wrench", tare_time=0.0)
    ideal(state(turned), np.zeros(6))
    np.testing.assert_allclose(tau(state(turned, 5.0), offset + push), ideal(state(turned, 5.0), push), atol=0.1)


def test_torques_pass_as_they_are_and_the_sign_can_be_turned(panda):
    values = np.arange(7.0)
    np.testing.assert_array_equal(converter(panda)(state(panda.config.seed), values), values)
    np.testing.assert_array_equal(converter(panda, sign=-1.0)(state(panda.config.seed), values), -values)


@pytest.mark.parametrize("settings", [{}, {"source": "wrench"}, {"source": "momentum"}])
def test_values_that_cannot_be_used_are_refused(panda, settings):
    tau = converter(panda, **settings)
    with pytest.raises(ShapeError):
        tau(state(panda.config.seed), np.zeros(5))
    with pytest.raises(InputError, match="not finite"):
        tau(state(panda.config.seed), np.full(6 if settings.get("source") == "wrench" else 7, np.nan))


def test_settings_that_cannot_work_are_refused_with_what_would(panda):
    for wrong, word in (({"source": "magic"}, "joint_state, field, wrench, momentum"), ({"source": "field"}, "package"),
                        ({"source": "field", "type": "a/msg/B"}, "field"), ({"sign": 0.5}, "1 or -1"),
                        ({"tare_time": -1.0}, "tare_time")):
        with pytest.raises(ConfigError, match=word):
            ExternalTorqueConfig(**wrong)
    with pytest.raises(ConfigError, match="panda_hand_tcp"):
        converter(panda, source="wrench", frame="tool0_controller")


def test_topics_fit_the_source():
    assert [ExternalTorqueConfig(source=s).topic for s in ("joint_state", "wrench", "momentum")] == [
        "external_torques", "wrench", "joint_states"]
    assert ExternalTorqueConfig(source="wrench", topic="/ft/wrench").topic == "/ft/wrench"
