"""Runs people: in this process, in processes of this machine, or on the machines of a Dask cluster."""

from __future__ import annotations

import logging
import traceback
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack

from distributed import Client, LocalCluster, as_completed
from distributed.scheduler import KilledWorker
from threadpoolctl import threadpool_limits

from unifeed_ros import __version__
from unifeed_ros.core.errors import ConfigError, UnifeedError
from unifeed_ros.experiments.experiment import Experiment, Row, RunSettings, failed_rows, person_rows

CONNECT = 10.0
"""How long a scheduler is waited for [s]."""
_DIED = "the process that ran it ended, also when it ran alone (memory?)"


def run_people(experiment: Experiment, people: Sequence[int], settings: RunSettings, *, jobs: int = 1,
               cluster: str = "") -> Iterator[tuple[int, list[Row]]]:
    """Run people, each on one thread, and give them as they finish.

    A person whose run fails is given with failed rows. One whose process ends is run again by another; those whose
    processes ended four times are run again at the end, each alone: who ended them shows then, and is given as failed.

    Args:
        experiment: The experiment.
        people: Numbers of the people.
        settings: Settings of the run.
        jobs: Processes at once; 1: this one.
        cluster: Address of a Dask scheduler, for example tcp://host:8786; empty: this machine.

    Yields:
        Number and complete rows of each person.

    Raises:
        ConfigError: No scheduler answers, it has no workers, or they have another version of this package.
        ClusterLostError: The scheduler went away.
    """
    if not people:
        return
    if jobs == 1 and not cluster:
        for person in people:
            yield person, run_one(experiment, person, settings)
        return
    with ExitStack() as stack:
        client = stack.enter_context(_connected(cluster) if cluster else _local(stack, jobs))
        _require_same_version(client)
        died = []
        for person, rows in _submitted(client, experiment, people, settings):
            if rows is None:
                died.append(person)
            else:
                yield person, rows
        for person in sorted(died):
            for _, rows in _submitted(client, experiment, [person], settings):
                yield person, failed_rows(experiment, person, _DIED) if rows is None else rows


def _submitted(client: Client, experiment: Experiment, people: Sequence[int],
               settings: RunSettings) -> Iterator[tuple[int, list[Row] | None]]:
    """Give people as workers finish them; no rows for those who the scheduler gave up because their workers ended."""
    futures = {client.submit(run_one, experiment, person, settings, pure=False): person for person in people}
    for future in as_completed(futures):
        person = futures.pop(future)
        try:
            yield person, future.result()  # waits where the worker that held it ended meanwhile: it is run again
        except KilledWorker:
            yield person, None
        except CancelledError as error:
            raise ClusterLostError("the Dask scheduler went away", got=f"{len(futures) + 1} people not finished",
                                   mend="go on with --resume") from error
        except Exception as error:  # of the worker's own making: run_one lets none through
            yield person, failed_rows(experiment, person, f"{type(error).__name__}: {error}")
        future.release()


def run_one(experiment: Experiment, person: int, settings: RunSettings) -> list[Row]:
    """Run one person; any failure becomes failed rows.

    Args:
        experiment: The experiment.
        person: Number of the person.
        settings: Settings of the run.

    Returns:
        Complete rows.
    """
    with threadpool_limits(limits=1):
        try:
            return person_rows(experiment, person, experiment.run_person(person, settings))
        except Exception as error:
            return failed_rows(experiment, person, _where(error))


class ClusterLostError(UnifeedError):
    """The scheduler went away before all people were finished."""


def _where(error: Exception) -> str:
    """Say what failed and in which line."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {error} ({last.name}, line {last.lineno})"


def _local(stack: ExitStack, jobs: int) -> Client:
    """Start processes of this machine, which end with this one."""
    # what a machine says of workers that are busy for minutes is no news here
    return Client(stack.enter_context(LocalCluster(
        n_workers=jobs, threads_per_worker=1, processes=True, memory_limit=0, dashboard_address=None,
        host="127.0.0.1", silence_logs=logging.ERROR)))


def _connected(address: str) -> Client:
    try:
        client = Client(address, timeout=CONNECT)
    except (OSError, TimeoutError, ValueError) as error:
        raise ConfigError(f"no Dask scheduler answers at {address}", expected="an address such as tcp://host:8786",
                          got=str(error), mend="start `dask scheduler`, and `dask worker` beside it") from error
    if not client.scheduler_info()["workers"]:
        client.close()
        raise ConfigError(f"the Dask scheduler at {address} has no workers", expected="one at least",
                          mend=f"start some with `dask worker {address} --nthreads 1`")
    return client


def _require_same_version(client: Client) -> None:
    """Refuse workers without this package: they would fail every person."""
    try:
        versions = client.run(_version)
    except Exception as error:  # what a worker cannot import is raised here, whatever it is
        raise ConfigError("the workers cannot load this package", got=f"{type(error).__name__}: {error}",
                          mend="install the same version on every machine") from error
    if set(versions.values()) != {__version__}:
        raise ConfigError("version of this package on the workers", expected=__version__,
                          got=", ".join(sorted(set(versions.values()))), mend="install the same on every machine")


def _version() -> str:
    return __version__
