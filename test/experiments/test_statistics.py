"""The statistics of experiments against hand-worked numbers and scipy's."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from unifeed_ros.core.errors import InputError
from unifeed_ros.experiments.statistics import (
    bootstrap_interval,
    mean_table,
    normality,
    paired_tests,
    residuals,
    rm_anova,
)


def long_form(matrix, methods):
    return pd.DataFrame([{"person": p, "method": m, "regret": float(matrix[p, k])}
                         for p in range(len(matrix)) for k, m in enumerate(methods)])


BY_HAND = np.array([[1.0, 3.0, 5.0], [2.0, 3.0, 7.0], [3.0, 6.0, 6.0]])
"""Means of columns 2, 4, 6; of rows 3, 4, 5; of all 4. SS of methods 24, of people 6, in all 34, so of the error 4."""


def test_anova_by_hand():
    """F = (24 / 2) / (4 / 4) = 12; generalised eta squared = 24 / (24 + 6 + 4)."""
    found = rm_anova(long_form(BY_HAND, "abc"), "regret", "method")[0]
    assert found.statistic == pytest.approx(12.0)
    assert found.effect_size == pytest.approx(24.0 / 34.0)
    assert found.df_effect == pytest.approx(2.0 * found.epsilon)
    assert found.df_error == pytest.approx(4.0 * found.epsilon)
    assert found.p == pytest.approx(stats.f.sf(12.0, 2.0 * found.epsilon, 4.0 * found.epsilon))
    assert "F(" in str(found)


def test_epsilon_is_that_of_the_contrasts_covariance():
    """Greenhouse and Geisser: tr(S)^2 / (d tr(S^2)) of d = 3 orthonormal contrasts."""
    matrix = np.random.default_rng(0).normal(size=(12, 4)) * [1.0, 1.0, 2.0, 5.0]
    contrasts = np.linalg.svd(np.eye(4) - 0.25)[0][:, :3]
    covariance = np.cov((matrix @ contrasts).T)
    wanted = np.trace(covariance) ** 2 / (3.0 * np.trace(covariance @ covariance))
    assert rm_anova(long_form(matrix, "abcd"), "regret", "method")[0].epsilon == pytest.approx(wanted)


def test_anova_of_two_methods_is_the_paired_t_test():
    matrix = np.random.default_rng(1).normal(size=(9, 2))
    found = rm_anova(long_form(matrix, "ab"), "regret", "method")[0]
    t = stats.ttest_rel(matrix[:, 0], matrix[:, 1])
    assert found.statistic == pytest.approx(t.statistic**2)
    assert found.p == pytest.approx(t.pvalue)


def test_anova_of_two_factors_gives_each_and_their_interaction():
    rng = np.random.default_rng(2)
    rows = pd.DataFrame([{"person": p, "task": t, "method": m, "regret": rng.normal() + 3.0 * (m == "a")}
                         for p in range(8) for t in ("table", "cup", "laptop") for m in "ab"])
    found = {one.effect: one for one in rm_anova(rows, "regret", ["task", "method"])}
    assert set(found) == {"task", "method", "task * method"}
    assert found["method"].p < 0.001 < found["task"].p
    means = rows.groupby(["person", "method"])["regret"].mean().unstack()
    assert found["method"].statistic == pytest.approx(stats.ttest_rel(means["a"], means["b"]).statistic ** 2)


def test_paired_tests_are_scipys_with_holms_correction():
    matrix = np.random.default_rng(3).normal(loc=[0.0, 0.9, 0.2], size=(15, 3))
    found = paired_tests(long_form(matrix, "abc"), "regret", [("a", "b"), ("a", "c"), ("b", "c")])
    raw = [stats.ttest_rel(matrix[:, i], matrix[:, j]) for i, j in ((0, 1), (0, 2), (1, 2))]
    order = np.argsort([t.pvalue for t in raw])
    holm = np.maximum.accumulate([min(1.0, (3 - k) * raw[i].pvalue) for k, i in enumerate(order)])
    for place, index in enumerate(order):
        assert found[index].p == pytest.approx(holm[place])
        assert found[index].statistic == pytest.approx(raw[index].statistic)
    assert found[0].mean == pytest.approx((matrix[:, 0] - matrix[:, 1]).mean())
    assert found[0].interval[0] < found[0].mean < found[0].interval[1]


def test_exchanging_the_two_turns_every_sign():
    rows = long_form(np.random.default_rng(4).normal(loc=[0.0, 2.0], size=(10, 2)), "ab")
    (one,), (other,) = (paired_tests(rows, "regret", [pair]) for pair in (("a", "b"), ("b", "a")))
    assert (one.mean, one.statistic, one.effect_size) == pytest.approx(
        (-other.mean, -other.statistic, -other.effect_size))
    assert one.p == other.p
    assert one.less and not other.less and not one.alike


def test_equal_measurements_are_alike():
    matrix = np.repeat(np.arange(5.0)[:, None], 2, axis=1)
    (test,) = paired_tests(long_form(matrix, "ab"), "regret", [("a", "b")])
    assert test.alike and test.interval == (0.0, 0.0) and test.p == 1.0


def test_several_measurements_of_one_person_count_as_their_mean():
    rows = long_form(BY_HAND, "abc")
    twice = pd.concat([rows.assign(regret=rows["regret"] - 1.0), rows.assign(regret=rows["regret"] + 1.0)])
    assert rm_anova(twice, "regret", "method") == rm_anova(rows, "regret", "method")
    assert paired_tests(twice, "regret", [("a", "b")]) == paired_tests(rows, "regret", [("a", "b")])
    assert mean_table(twice, "regret", ["method"]) == mean_table(rows, "regret", ["method"])


def test_interval_holds_the_mean_about_as_often_as_it_says():
    rng = np.random.default_rng(5)
    held = 0
    for k in range(60):
        low, high = bootstrap_interval(rng.exponential(size=40), seed=k)
        held += low <= 1.0 <= high
    assert 49 <= held <= 60  # 95 % of 60 is 57; below 49 with a probability under 1e-3


def test_normal_residuals_look_normal_and_others_do_not():
    rng = np.random.default_rng(6)
    assert normality(rng.normal(size=300)).p > 0.05
    found = normality(rng.exponential(size=300))
    assert found.p < 1e-6 and found.correlation < 0.95


def test_residuals_have_neither_peoples_nor_methods_means():
    left = residuals(long_form(BY_HAND, "abc"), "regret").reshape(3, 3)
    np.testing.assert_allclose([left.sum(axis=0), left.sum(axis=1)], 0.0, atol=1e-12)
    assert (left**2).sum() == pytest.approx(4.0)


@pytest.mark.parametrize("broken", ["one person", "a gap", "no number", "another name"])
def test_what_cannot_be_compared_is_refused(broken):
    rows = long_form(BY_HAND, "abc")
    pairs = [("a", "b")]
    if broken == "one person":
        rows = rows[rows["person"] == 0]
    elif broken == "a gap":
        rows = rows.iloc[1:]
    elif broken == "no number":
        rows.loc[0, "regret"] = np.nan
    else:
        pairs = [("a", "nobody")]
    with pytest.raises(InputError):
        paired_tests(rows, "regret", pairs)
    if broken != "another name":
        with pytest.raises(InputError):
            rm_anova(rows, "regret", "method")
