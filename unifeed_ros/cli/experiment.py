"""`unifeed experiment NAME`: the paper's comparisons, with their statistics, page and figures."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from pathlib import Path
from typing import Any

from unifeed_ros.cli.arguments import UserMistake
from unifeed_ros.experiments.experiment import (
    EXPERIMENTS,
    OK,
    RunSettings,
    Summary,
    find_experiment,
)


def add_experiment_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `experiment` to the command line."""
    text = "repeat one of the paper's comparisons, docs/experiments.md"
    parser = commands.add_parser("experiment", help=text, description=text)
    parser.add_argument("name", metavar="NAME", help=f"one of {', '.join(EXPERIMENTS)}")
    parser.add_argument("--people", type=int, help="simulated people (default: the paper's number)")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)),
                        help="processes at once (default: one a core)")
    parser.add_argument("--cluster", default="", metavar="ADDRESS",
                        help="run on the workers of this Dask scheduler, such as tcp://host:8786")
    parser.add_argument("--out", type=Path, help="folder of the results (default: out/experiment-<NAME>)")
    parser.add_argument("--resume", action="store_true", help="go on in that folder; people who failed are run again")
    parser.add_argument("--seed", type=int, default=0, help="seed of everything random (default: 0)")
    parser.add_argument("--json", action="store_true", help="print the summary as JSON")
    parser.set_defaults(run=run_experiment)


def run_experiment(options: argparse.Namespace) -> int:
    """Run people, then analyse, draw and write the page; 0 only if nobody failed.

    Raises:
        UserMistake: A number that runs nothing.
        ConfigError: An unknown experiment, a folder that cannot be used, or a cluster that cannot be reached.
    """
    os.environ["OMP_NUM_THREADS"] = "1"  # before torch reads it: each person is given one thread
    from unifeed_ros.experiments.page import write_page
    from unifeed_ros.experiments.progress import Progress
    from unifeed_ros.experiments.running import ClusterLostError, run_people
    from unifeed_ros.experiments.storage import ResultFolder, write_whole

    experiment = find_experiment(options.name)
    count = experiment.people if options.people is None else options.people
    for name, value in (("--people", count), ("--jobs", options.jobs)):
        if value < 1:
            raise UserMistake(name, expected="at least 1", got=value)
    settings = RunSettings(seed=options.seed)
    out = (options.out or Path("out") / f"experiment-{options.name}").expanduser().resolve()
    folder = ResultFolder(out, experiment.name, settings, resume=options.resume)
    finished = folder.finished(range(count))
    progress = Progress(count, len(finished))
    _say(progress.line)
    try:
        for person, rows in run_people(experiment, sorted(set(range(count)) - set(finished)), settings,
                                       jobs=min(options.jobs, count), cluster=options.cluster):
            folder.keep(person, rows)
            if line := progress.count(rows):
                _say(line)
    except ClusterLostError as error:
        _say(str(error))
        return 1
    rows = folder.collect(range(count))
    nothing = not (rows["status"] == OK).any()
    summary = Summary(people=0, excluded=list(range(count))) if nothing else experiment.analyse(rows)
    figures = [] if nothing else experiment.draw(rows, out)
    command = f"unifeed experiment {options.name} --people {count} --seed {options.seed}"
    run = progress.describe(rows, command, options.jobs, options.cluster)
    text = json.dumps(_writable(summary.to_mapping()), indent=2, ensure_ascii=False)
    write_whole(out / "summary.json", text.encode())
    write_whole(out / "run.json", json.dumps(run, indent=2).encode())
    page = write_page(out, experiment, summary, rows, figures, run)
    print(text if options.json else "\n".join(_lines(summary, page)))
    return int(bool(summary.excluded))


def _lines(summary: Any, page: Path) -> list[str]:
    words = {True: "supported", False: "NOT supported", None: "cannot be said"}
    return [*(f"{f.hypothesis}: {words[f.supported]}. {f.ours}" for f in summary.findings),
            *(f"{len(summary.excluded)} people with failed runs: {', '.join(map(str, summary.excluded))}"
              for _ in summary.excluded[:1]),
            f"{page}"]


def _writable(value: Any) -> Any:
    """Replace what JSON has no word for by null."""
    if isinstance(value, dict):
        return {key: _writable(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_writable(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
