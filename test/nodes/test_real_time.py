"""Each case in a process of its own: scheduling and the garbage collector belong to the whole process."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

from unifeed_ros.core.errors import ConfigError
from unifeed_ros.nodes.real_time import RealTimeConfig

PROCESS = """
import gc, os, resource, threading
from unifeed_ros.nodes.real_time import RealTimeConfig, calm_garbage_collector, prefer_real_time

forbidden = {forbidden}
if forbidden:
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
    resource.setrlimit(resource.RLIMIT_NICE, (0, 0))
    if os.geteuid() == 0:
        os.setuid(65534)
done = threading.Event()
thread = threading.Thread(target=done.wait)
thread.start()
calm_garbage_collector()
print(prefer_real_time(RealTimeConfig(priority={priority})))
print(*(os.sched_getscheduler(t) for t in (0, thread.native_id)), os.SCHED_FIFO, gc.get_freeze_count() > 1000)
done.set()
"""


def asked(priority=20, forbidden=False):
    code = PROCESS.format(priority=priority, forbidden=forbidden)
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True,
                            env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"})
    said, figures = result.stdout.splitlines()
    own, other, fifo, frozen = figures.split()
    assert frozen == "True"
    return said, own == fifo, other == fifo


def test_what_it_says_is_what_every_thread_got():
    said, own, other = asked()
    assert own == other == said.startswith("SCHED_FIFO 20")


def test_without_permission_it_says_where_to_ask():
    said, own, other = asked(forbidden=True)
    assert "not permitted (rtprio" in said and not own and not other


def test_it_can_be_switched_off():
    said, own, other = asked(priority=0)
    assert said == "ordinary scheduling, as configured" and not own and not other


def test_priorities_that_do_not_exist_are_refused():
    with pytest.raises(ConfigError, match="0 to 99"):
        RealTimeConfig(priority=100)


@pytest.mark.skipif(not Path("/proc/self/autogroup").exists(), reason="this kernel has no autogroups")
@pytest.mark.parametrize("own_session", [True, False])
def test_a_session_of_its_own_gives_way_and_one_that_is_shared_does_not(own_session):
    code = ("import os; before = open('/proc/self/autogroup').read()\n"
            "from unifeed_ros.nodes.real_time import set_niceness\n"
            "set_niceness(7)\nprint(repr((os.nice(0), before, open('/proc/self/autogroup').read())))")
    began = os.nice(0)
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True,
                            start_new_session=own_session)
    niceness, before, after = ast.literal_eval(result.stdout)
    assert niceness == min(began + 7, 19)
    if own_session:
        assert after.split()[-2:] == ["nice", "7"]
    else:  # before is empty where the process is in no group, as under some container runtimes
        assert after == before
