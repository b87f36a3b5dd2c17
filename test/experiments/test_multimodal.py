"""The experiment `multimodal`: everyone meets the same people, splits are even, and rows become findings."""

import numpy as np
import pandas as pd
import pytest

from unifeed_ros.baselines.policies import Worker
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.reward.queries import QueryConfig
from unifeed_ros.experiments.experiment import FAILED, RunSettings, find_experiment
from unifeed_ros.experiments.features import lesson_of
from unifeed_ros.experiments.multimodal import INPUTS, TASKS, MultimodalConfig, run_condition, run_policy
from unifeed_ros.experiments.multimodal_findings import DCP, END_TO_END, OURS, RRIC, analyse, draw

QUICK = MultimodalConfig(ours=TrainingConfig(members=3), questions=QueryConfig(candidates=60))


@pytest.fixture(scope="module")
def lesson():
    return lesson_of("laptop", 0, RunSettings(), "panda")


def rows_without_times(method, lesson, inputs):
    rows = run_condition(method, lesson, np.random.default_rng(0), QUICK, inputs)
    return [{k: v for k, v in row.items() if "seconds" not in k} for row in rows]


def test_each_method_has_six_inputs_evenly_split():
    assert (INPUTS["BC"], INPUTS["AIRL"], INPUTS["Atari"]) == ("DDDDDD", "DDDDDD", "DDPPPP")  # the paper's
    for method, inputs in INPUTS.items():
        if method in END_TO_END:
            continue
        kinds = DCP if method == RRIC else method
        letters = kinds.removeprefix("Ours (").removesuffix(")")
        assert len(inputs) == 6 and {inputs.count(letter) for letter in letters} == {6 // len(letters)}
        assert "".join(sorted(inputs, key="DCP".index)) == inputs  # demonstrations, corrections, then rankings


@pytest.mark.parametrize(("method", "inputs"), [(DCP, "DCP"), (RRIC, "DCP"), ("Ours (C)", "C"), ("Ours (P)", "PP")])
def test_inputs_teach_more_than_no_reward_and_the_same_seed_gives_the_same_rows(lesson, method, inputs):
    rows = rows_without_times(method, lesson, inputs)
    assert [row["input"] for row in rows] == list(inputs)
    if "D" in inputs:
        assert rows[-1]["normalised_regret"] < 0.5
    if method in (DCP, RRIC):
        assert rows == rows_without_times(method, lesson, inputs)


def rows_of(people, regrets):
    """Rows of two interactions; regrets of the last one by method, with some noise."""
    rng, rows = np.random.default_rng(0), []
    for person in range(people):
        for task in TASKS:
            for method, regret in regrets.items():
                rows += [{"experiment": "multimodal", "task": task, "method": method, "person": person,
                          "interaction": k, "regret": share * regret + (noise := rng.uniform(0.0, 0.1)),
                          "normalised_regret": share * regret + noise, "planned": True, "optimum_gap": 0.0,
                          "status": "ok", "message": ""} for k, share in ((1, 2.0), (2, 1.0))]
    return pd.DataFrame(rows)


BEST = {**dict.fromkeys(OURS, 2.0), DCP: 1.0, RRIC: 1.0}


def test_hypotheses_are_found_where_they_hold_and_not_where_they_do_not():
    found = {f.hypothesis: f for f in analyse(rows_of(15, BEST)).findings}
    assert found["H1"].supported and found["H2"].supported is None and "BC" in found["H2"].ours
    everyone = {**BEST, **dict.fromkeys(END_TO_END, 3.0)}
    assert all(f.supported for f in analyse(rows_of(15, everyone)).findings if f.hypothesis != "H3")
    worse = {**everyone, "Ours (DC)": 0.5, "AIRL": 0.5, RRIC: 0.5}
    found = {f.hypothesis: f for f in analyse(rows_of(15, worse)).findings}
    assert not any(f.supported for f in found.values())
    assert "Ours (DC)" in found["H1"].ours and "AIRL" in found["H2"].ours and "more regret" in found["H3"].ours


def test_methods_that_failed_with_everybody_are_left_out_and_said_to_be():
    rows = rows_of(5, {**BEST, "BC": 3.0})
    rows.loc[rows["method"] == "BC", ["status", "message"]] = "failed", "no environment"
    summary = analyse(rows)
    assert summary.people == 5 and summary.excluded == list(range(5))
    assert {f.hypothesis: f.supported for f in summary.findings} == {"H1": True, "H2": None, "H3": True}
    assert any("BC" in note and "failed" in note for note in summary.notes)


def test_a_person_with_one_failed_run_is_left_out_of_the_statistics():
    rows = rows_of(5, {**BEST, "BC": 3.0})
    rows.loc[(rows["person"] == 2) & (rows["method"] == "BC"), "status"] = "failed"
    summary = analyse(rows)
    assert summary.people == 4 and summary.excluded == [2]
    assert all(t.people == 4 for f in summary.findings for t in f.tests)


@pytest.mark.parametrize("method", END_TO_END)
def test_a_policy_that_cannot_be_trained_is_a_failed_row_that_says_how_to_mend_it(lesson, method, tmp_path):
    with Worker(tmp_path / "python") as missing:
        (row,) = run_policy(method, lesson, missing, QUICK)
    assert (row["status"], row["task"], row["method"]) == (FAILED, "laptop", method)
    assert "make policies" in row["message"]


@pytest.mark.parametrize("people", [1, 3])
def test_few_people_still_give_tables_and_figures(people, tmp_path):
    rows = rows_of(people, BEST)
    summary = analyse(rows)
    assert summary.people == people and bool(summary.findings) == (people > 2)
    assert len(draw(rows, tmp_path)) == 2


def test_it_is_registered_with_every_condition():
    experiment = find_experiment("multimodal")
    assert len(experiment.conditions) == len(TASKS) * 11 and experiment.people == 15
