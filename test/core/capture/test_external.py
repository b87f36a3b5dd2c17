import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unifeed_ros.core.capture.external import by_name, torque_from_wrench
from unifeed_ros.core.errors import InputError, ShapeError

UR_KINEMATIC = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")


@given(st.permutations(range(6)))
def test_any_order_of_names_gives_the_order_wanted(order):
    names = [UR_KINEMATIC[k] for k in order] + ["finger"]
    np.testing.assert_array_equal(by_name(names, [*order, 9.0], UR_KINEMATIC), np.arange(6))


def test_missing_repeated_and_unusable_values_are_refused():
    with pytest.raises(InputError, match="lack joints b"):
        by_name(["a"], [1.0], ["a", "b"])
    with pytest.raises(InputError, match="number of efforts"):
        by_name(["a", "b"], [], ["a", "b"], "efforts")
    with pytest.raises(InputError, match="repeat"):
        by_name(["a", "a"], [1.0, 2.0], ["a"])
    with pytest.raises(InputError, match="not finite"):
        by_name(["a", "b"], [1.0, np.nan], ["a", "b"])
    assert by_name(["a", "b"], [1.0, np.nan], ["a"]).tolist() == [1.0]


@given(st.integers(0, 1000))
def test_torque_of_a_wrench_does_the_same_work(panda, seed):
    rng = np.random.default_rng(seed)
    q = rng.uniform(panda.lower, panda.upper)
    wrench, dq = rng.normal(size=6), 1e-6 * rng.normal(size=panda.n)
    tau = torque_from_wrench(panda, q, wrench)
    force_work = wrench[:3] @ (panda.tool_pose(q + dq)[0] - panda.tool_pose(q - dq)[0])
    turned = panda.tool_pose(q + dq)[1] @ panda.tool_pose(q - dq)[1].T
    angle = 0.5 * np.array([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]])
    assert tau @ (2 * dq) == pytest.approx(force_work + wrench[3:] @ angle, abs=1e-11)


def test_wrench_of_another_shape_is_refused(panda):
    with pytest.raises(ShapeError):
        torque_from_wrench(panda, panda.config.seed, np.zeros(3))
    with pytest.raises(InputError):
        torque_from_wrench(panda, np.full(panda.n, np.nan), np.zeros(6))
