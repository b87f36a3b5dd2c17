"""What holds for every experiment: same seed same bytes, nothing finished is lost, nothing failed is dropped."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import sys
import time
import types

import dask
import numpy as np
import pandas as pd
import pytest
from distributed import LocalCluster

from unifeed_ros.cli.main import main
from unifeed_ros.core.errors import ConfigError
from unifeed_ros.experiments import running
from unifeed_ros.experiments.deformations import EXPERIMENT as DEFORMATIONS
from unifeed_ros.experiments.experiment import (
    EXPERIMENTS,
    Condition,
    Experiment,
    RunSettings,
    Summary,
    complete_people,
    find_experiment,
)
from unifeed_ros.experiments.running import ClusterLostError, run_people
from unifeed_ros.experiments.storage import ResultFolder

SETTINGS = RunSettings(seed=5)


def run(*words, jobs=1):
    return main(["experiment", *map(str, words), "--jobs", str(jobs)])


def toy(run_person=None):
    """Make an experiment of two methods; defined in a function, it travels to other processes by value."""

    def measured(person, settings):
        return [{"task": "toy", "method": m, "interaction": k, "regret": float(settings.rng(person).normal()) + k,
                 "seconds_train": 0.1} for m in ("b", "a") for k in (2, 1)]

    def analysed(rows):
        complete, excluded = complete_people(rows)
        assert len(complete), "there is nothing to analyse"
        return Summary(people=complete["person"].nunique(), excluded=excluded)

    return Experiment(name="toy", title="A toy", source="nothing", people=4, run_person=run_person or measured,
                      conditions=[Condition(task="toy", method=m) for m in "ab"], analyse=analysed,
                      draw=lambda rows, folder: [])


@pytest.fixture
def register(monkeypatch):
    def registered(experiment):
        module = types.ModuleType("toy_experiment")
        module.EXPERIMENT = experiment
        monkeypatch.setitem(sys.modules, "toy_experiment", module)
        monkeypatch.setitem(EXPERIMENTS, "toy", "toy_experiment")

    return registered


@pytest.mark.parametrize("name", list(EXPERIMENTS))
def test_every_experiment_is_whole(name):
    experiment = find_experiment(name)
    assert experiment.name == name and experiment.people > 1
    assert len(set(experiment.conditions)) == len(experiment.conditions) > 1


def test_same_seed_same_bytes_another_seed_others(tmp_path):
    for folder, seed in (("first", 3), ("second", 3), ("third", 4)):
        assert run("deformations", "--people", 3, "--seed", seed, "--out", tmp_path / folder) == 0
    for name in ("results.parquet", "summary.json", "deformations.png"):
        contents = [(tmp_path / folder / name).read_bytes() for folder in ("first", "second", "third")]
        assert contents[0] == contents[1]
        assert name == "deformations.png" or contents[0] != contents[2]


def test_a_run_leaves_rows_summary_page_and_figures(tmp_path, capsys):
    assert run("deformations", "--people", 3, "--out", tmp_path, "--json") == 0
    printed = capsys.readouterr()
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert json.loads(printed.out) == summary and summary["people"] == 3
    assert "3 of 3 people" in printed.err
    rows = pd.read_parquet(tmp_path / "results.parquet")
    assert len(rows) == 3 * len(DEFORMATIONS.conditions)
    page = (tmp_path / "index.md").read_text()
    assert summary["findings"][0]["paper"] in page and "![deformations](deformations.png)" in page


def test_times_are_kept_apart_and_rows_are_sorted(tmp_path, register):
    register(toy())
    assert run("toy", "--out", tmp_path) == 0
    results, times = (pd.read_parquet(tmp_path / f"{name}.parquet") for name in ("results", "timings"))
    assert "seconds_train" in times and "seconds_train" not in results
    keys = ["experiment", "task", "method", "person", "interaction"]
    assert results[keys].equals(results[keys].sort_values(keys, ignore_index=True))
    assert results[keys].equals(times[keys])


def test_a_killed_run_goes_on_to_the_same_bytes(tmp_path, register):
    whole, broken, good = tmp_path / "whole", tmp_path / "broken", toy()

    def stuck(person, settings):
        time.sleep(60.0 if person == 6 else 0.0)
        return good.run_person(person, settings)

    register(toy(stuck))
    child = multiprocessing.get_context("fork").Process(target=run, args=("toy", "--people", 9, "--out", broken))
    child.start()
    while not (broken / "people" / "00005.json").exists():
        time.sleep(0.01)
    child.kill()
    child.join()
    assert not (broken / "results.parquet").exists()
    register(good)
    assert run("toy", "--people", 9, "--out", whole) == 0
    assert run("toy", "--people", 9, "--out", broken, "--resume") == 0
    assert json.loads((broken / "run.json").read_text())["people of this run"] == 3
    for name in ("results.parquet", "summary.json"):
        assert (whole / name).read_bytes() == (broken / name).read_bytes()


def test_a_failed_person_is_listed_in_every_condition_and_run_again(tmp_path, register, capsys):
    good, ill = toy(), {1}

    def sometimes(person, settings):
        if person in ill:
            raise ValueError("no | motion")
        return good.run_person(person, settings)

    register(toy(sometimes))
    assert run("toy", "--out", tmp_path) == 1
    rows = pd.read_parquet(tmp_path / "results.parquet")
    failed = rows[rows["status"] == "failed"]
    assert sorted(failed["method"]) == ["a", "b"] and set(failed["person"]) == {1}
    assert failed["message"].str.contains("ValueError: no | motion", regex=False).all()
    assert json.loads((tmp_path / "summary.json").read_text()) == {
        "people": 3, "excluded": [1], "findings": [], "anovas": {}, "tables": {}, "notes": []}
    assert "| 1 | toy | a | 0 | ValueError: no / motion" in (tmp_path / "index.md").read_text()
    assert "1 people with failed runs: 1" in capsys.readouterr().out
    ill.update(range(4))
    assert run("toy", "--out", tmp_path / "all") == 1
    assert len(pd.read_parquet(tmp_path / "all" / "results.parquet")) == 8
    ill.clear()
    assert run("toy", "--out", tmp_path, "--resume") == 0
    assert (pd.read_parquet(tmp_path / "results.parquet")["status"] == "ok").all()


def test_a_cluster_gives_the_same_rows_though_a_worker_is_killed():
    """One of two workers is killed while it runs a person, who is then run alone, and ends another."""

    def slow(person, settings):
        time.sleep(0.05)
        if person == 7:
            os.kill(os.getpid(), signal.SIGKILL)
        return [{"task": "toy", "method": m, "interaction": 1, "regret": float(settings.rng(person).normal())}
                for m in "ab"]

    def steady(person, settings):
        return slow(person, settings) if person != 7 else []

    wanted = {person: rows for person, rows in run_people(toy(steady), range(16), SETTINGS) if person != 7}
    with (dask.config.set({"distributed.scheduler.allowed-failures": 0}),
          LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1",
                       silence_logs="CRITICAL") as cluster):
        found = dict(run_people(toy(slow), range(16), SETTINGS, cluster=cluster.scheduler_address))
    died = found.pop(7)
    assert found == wanted
    assert [(row["method"], row["status"]) for row in died] == [("a", "failed"), ("b", "failed")]
    assert "also when it ran alone" in died[0]["message"]


def test_a_cluster_that_goes_away_is_said():
    def endless(person, settings):
        time.sleep(0.0 if person == 0 else 1.0)
        return []

    cluster = LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None,
                           silence_logs="CRITICAL")
    people = run_people(toy(endless), range(3), SETTINGS, cluster=cluster.scheduler_address)
    assert next(people)[0] == 0
    cluster.close()
    with pytest.raises(ClusterLostError, match="--resume"):
        list(people)


@pytest.mark.parametrize(("words", "says"), [
    (("deformation",), "deformations"), (("deformations", "--people", 0), "--people"),
    (("deformations", "--jobs", 0), "--jobs")])
def test_a_mistake_is_said_in_one_line(tmp_path, capsys, words, says):
    assert main(["experiment", *map(str, words), "--out", str(tmp_path)]) == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 1 and says in errors[0]
    assert not list(tmp_path.iterdir())


def test_a_scheduler_that_does_not_answer_is_said(monkeypatch):
    monkeypatch.setattr(running, "CONNECT", 0.3)
    with pytest.raises(ConfigError, match="no Dask scheduler answers"):
        list(run_people(toy(), range(2), SETTINGS, cluster="tcp://127.0.0.1:9"))


def test_results_are_neither_overwritten_nor_mixed(tmp_path):
    folder = ResultFolder(tmp_path, "toy", SETTINGS, resume=False)
    folder.keep(0, [{"person": 0, "status": "ok", "interaction": 1}])
    with pytest.raises(ConfigError, match="--resume"):
        ResultFolder(tmp_path, "toy", SETTINGS, resume=False)
    for name, settings in (("other", SETTINGS), ("toy", RunSettings(seed=6))):
        with pytest.raises(ConfigError, match="another run"):
            ResultFolder(tmp_path, name, settings, resume=True)
    assert ResultFolder(tmp_path, "toy", SETTINGS, resume=True).finished(range(3)) == [0]


def test_a_file_that_was_being_written_does_not_count(tmp_path):
    folder = ResultFolder(tmp_path, "toy", SETTINGS, resume=False)
    (tmp_path / "people" / ".00001.json").write_text('[{"person": 1,')
    assert folder.finished(range(3)) == []


def test_people_are_independent_of_each_other_and_of_the_order():
    rngs = [RunSettings(seed=1).rng(person, stream).random(4) for person in (0, 1) for stream in (0, 1)]
    assert len({tuple(r) for r in rngs}) == 4
    np.testing.assert_array_equal(RunSettings(seed=1).rng(1, 1).random(4), rngs[3])
