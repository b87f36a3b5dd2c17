import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unifeed_ros.core.capture.external import by_name
from unifeed_ros.core.errors import InputError

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
