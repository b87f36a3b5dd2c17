"""The experiment `features`: everyone meets the same people, a short lesson teaches, and rows become findings."""

import numpy as np
import pandas as pd
import pytest

from unifeed_ros.baselines.ferl import FerlConfig
from unifeed_ros.baselines.learned_feature import TraceTraining
from unifeed_ros.experiments.experiment import RunSettings, find_experiment
from unifeed_ros.experiments.features import LearnedFeatures, MethodSettings, lesson_of, run_condition, scene_of
from unifeed_ros.experiments.features_findings import FEATURES, KNOWN, METHODS, analyse, draw, label

QUICK = MethodSettings(ferl=FerlConfig(traces=TraceTraining(epochs=2, choosing_epochs=1)))


@pytest.fixture(scope="module")
def lesson():
    return lesson_of("laptop", 0, RunSettings())


@pytest.fixture(scope="module")
def learned(lesson):
    return LearnedFeatures("laptop", lesson, QUICK.ferl)


def test_the_optimum_is_confirmed_by_another_solver(lesson):
    assert abs(lesson.optimum.gap) < 0.01


def test_people_differ_in_where_they_start_and_act_alike_for_every_method(lesson):
    scenes = [scene_of(task, person, RunSettings()) for task, person in (("laptop", 0), ("cup", 0), ("laptop", 1))]
    assert np.array_equal(scenes[0].start, lesson.optimum.yardstick.task.scene.start)
    assert np.array_equal(scenes[0].start, scenes[1].start) and not np.array_equal(scenes[0].start, scenes[2].start)
    shown = [lesson.person().demonstrate("d").trajectory.positions.tobytes() for _ in range(2)]
    assert shown[0] == shown[1]


@pytest.mark.parametrize("method", METHODS)
def test_two_inputs_teach_more_than_no_reward(lesson, learned, method):
    known = "none known" if method == "Ours" else "all known"
    rows = run_condition("laptop", known, method, lesson, learned, QUICK, interactions=2)
    nothing = run_condition("laptop", "none known", "Coactive", lesson, learned, QUICK, interactions=1)
    assert [row["interaction"] for row in rows] == [1, 2]
    assert rows[-1]["regret"] < nothing[0]["regret"]
    assert all(row["planned"] and row["task"] == label("laptop", known) for row in rows)


def test_the_same_seed_gives_the_same_rows(lesson, learned):
    runs = [run_condition("laptop", "one missing", "Ours", lesson, learned, QUICK, interactions=1) for _ in range(2)]
    for one, two in zip(*runs, strict=True):
        assert {k: v for k, v in one.items() if "seconds" not in k} == {
            k: v for k, v in two.items() if "seconds" not in k}


def rows_of(people, regrets):
    """Rows of two interactions; regrets of the last one by method and set of features, with some noise."""
    rng, rows = np.random.default_rng(0), []
    for person in range(people):
        for task in FEATURES:
            for known in KNOWN:
                for method in METHODS:
                    for interaction, share in ((1, 2.0), (2, 1.0)):
                        regret = share * regrets[known][METHODS.index(method)] + rng.uniform(0.0, 0.1)
                        rows.append({"experiment": "features", "task": label(task, known), "known": known,
                                     "method": method, "person": person, "interaction": interaction,
                                     "regret": regret, "normalised_regret": regret, "planned": True,
                                     "optimum_gap": 0.0, "status": "ok", "message": ""})
    return pd.DataFrame(rows)


BETTER = {"all known": (1.0, 1.0, 1.0), "one missing": (5.0, 3.0, 1.0), "none known": (5.0, 5.0, 1.0)}


def test_hypotheses_are_found_where_they_hold_and_not_where_they_do_not():
    findings = analyse(rows_of(10, BETTER)).findings
    assert {f.hypothesis: f.supported for f in findings} == {"H6": True, "H7": True}
    worse = {**BETTER, "all known": (1.0, 1.0, 2.0), "one missing": (5.0, 1.0, 2.0)}
    findings = {f.hypothesis: f for f in analyse(rows_of(10, worse)).findings}
    assert not findings["H6"].supported and not findings["H7"].supported
    assert "table" in findings["H6"].ours and "than FERL" in findings["H7"].ours


@pytest.mark.parametrize("people", [1, 3])
def test_few_people_still_give_tables(people):
    summary = analyse(rows_of(people, BETTER))
    assert summary.people == people and bool(summary.findings) == (people > 2)


def test_one_person_still_gives_figures(tmp_path):
    figures = draw(rows_of(1, BETTER), tmp_path)
    assert len(figures) == 2 and all(path.is_file() for path in figures)


def test_it_is_registered_with_every_condition():
    experiment = find_experiment("features")
    assert len(experiment.conditions) == len(FEATURES) * len(KNOWN) * len(METHODS) == 27
    assert experiment.people == 10
