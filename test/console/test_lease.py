"""Control of a lesson: one at a time, and not for longer than it says that it is there."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from unifeed_ros.console.lease import LEASE_S, RENEW_S, ControlLease

NAMES = st.sampled_from(["page", "terminal", "other"])
STEPS = st.lists(st.tuples(st.sampled_from(["keep", "take", "release"]), NAMES, st.floats(0.0, 2 * LEASE_S)))


@given(STEPS)
def test_the_holder_asked_within_the_lease_and_was_not_overtaken(steps):
    lease, now, heard = ControlLease(), 0.0, {}
    for wish, name, wait in steps:
        now += wait
        before = lease.holder(now)
        assert before == "" or now - heard[before] < LEASE_S
        if wish == "release":
            lease.release(name)
            assert lease.holder(now) == ("" if before == name else before)
        elif wish == "take":
            lease.take(name, now)
            assert lease.holder(now) == name
        else:
            assert lease.keep(name, now) == (before in ("", name))
            assert lease.holder(now) == (before or name)
        if lease.holder(now) == name:
            heard[name] = now


def test_control_outlives_a_lost_word_and_not_its_holder():
    lease = ControlLease()
    assert 3 * RENEW_S <= LEASE_S
    assert lease.keep("page", 0.0) and lease.holder(2 * RENEW_S) == "page"
    assert not lease.keep("terminal", LEASE_S - 0.01)
    assert lease.keep("terminal", LEASE_S)
    assert not lease.keep("page", LEASE_S)
