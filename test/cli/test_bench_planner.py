"""The planner's benchmark: its table, and a run that is gone on with."""

from __future__ import annotations

import json

import pytest

from unifeed_ros.cli.arguments import UserMistake
from unifeed_ros.cli.bench_planner import SETTINGS, run
from unifeed_ros.cli.main import build_parser
from unifeed_ros.cli.planner_table import SUMMARY, describe, summarise


def figures(seconds, **more):
    return {"seconds": seconds, "solved": seconds < 0.3, "floor": 0.01, "iterations": 9, "message": "late",
            "excess": {"velocity": seconds / 100, "cone": 0.0}, "first": seconds / 10, "first_share": seconds,
            "touching": 0, "cancel": seconds / 20, **more}


def peer(seconds, converged=True, gap=0.01):
    return {"seconds": seconds, "converged": converged, "gap": gap}


def test_summary_takes_medians_and_counts():
    problems = [figures(0.1, halved_share=1.5, halved_gain=0.001, full_share=4.0, full_gain=0.002),
                figures(0.2, exact=peer(2.0), fd=peer(8.0, converged=False), own_s=0.4, piqp_s=0.2, osqp_s=1.0),
                figures(0.3)]
    summary, details = summarise(problems)
    assert tuple(summary) == SUMMARY
    assert (summary["median_s"], details["own_s"], summary["solved"], summary["problems"]) == (0.2, 0.4, 2, 3)
    assert (summary["ratio_exact"], summary["ratio_fd"]) == pytest.approx((10.0, 40.0))
    assert (details["exact_converged"], details["fd_converged"], details["fd_problems"]) == (1, 0, 1)
    assert (details["first_feasible_s"], details["touching"], details["failures"]) == (
        pytest.approx(0.02), 0, ["late"])
    assert (details["first_feasible_share"], details["cancel_worst_s"]) == (0.2, pytest.approx(0.015))
    assert summary["worst_violation"] == details["excess"]["velocity"] == pytest.approx(0.003)
    line = describe("panda table 20", summary, details)
    assert "SLSQP fd > 8.0 s (x > 40, converged 0/1)" in line and "SLSQP exact 2.0 s (x 10, converged 1/1)" in line
    assert "halved x1.50 of the time, objective +0.100%" in line


def test_a_median_is_a_bound_only_where_an_ended_peer_can_move_it():
    for last_converged, second_converged, bound in ((True, True, False), (False, True, False), (False, False, True)):
        problems = [figures(0.1, exact=peer(1.0)), figures(0.1, exact=peer(2.0, second_converged)),
                    figures(0.1, exact=peer(3.0, last_converged, gap=9.0))]
        summary, details = summarise(problems)
        assert summary["slsqp_exact_s"] == 2.0 and details["slsqp_exact_is_bound"] is bound
        assert (summary["objective_gap_p95"] < 0.02) is not last_converged  # of those that converged alone
        assert details["objective_gap_of_ended"] == (None if last_converged and second_converged else
                                                     0.01 if last_converged else 9.0)
    summary, details = summarise([figures(0.1)])
    assert summary["slsqp_fd_s"] is None and summary["objective_gap_p95"] is None
    assert "SLSQP" not in describe("ur10 cup 40", summary, details)


def test_a_run_in_random_places_is_gone_on_with(tmp_path, capsys):
    file = tmp_path / "results.jsonl"
    options = build_parser().parse_args([
        "bench", "planner", "--robot", "panda", "--task", "laptop", "--waypoints", "20", "--places", "--peer-pairs",
        "0", "--json", "--results", str(file), "--pairs", "3"])
    settings = {name: getattr(options, name) for name in SETTINGS}
    known = {"problem": "panda laptop 20 0", **figures(0.001)}
    before = f"{json.dumps(settings)}\n{json.dumps(known)}\n"
    file.write_text(before + '{"problem": "panda lap')  # interrupted
    assert run(options) == 1  # the made-up one exceeds a limit
    after = file.read_text()
    assert after.startswith(before) and len(after.splitlines()) == 4
    table = json.loads(capsys.readouterr().out)
    (row,), (details,) = table["summary"], table["details"]
    assert set(row) == {"robot", "task", "waypoints", *SUMMARY}
    assert row["problems"] == 3 and row["solved"] > 1 and details["touching"] == 0
    assert row["worst_violation"] == details["excess"]["velocity"] == 0.001 / 100
    assert max(excess for limit, excess in details["excess"].items() if limit != "velocity") <= 1e-6
    assert run(options) == 1 and file.read_text() == after
    options.starts = 2
    with pytest.raises(UserMistake, match="other options"):
        run(options)
    file.write_text("no JSON\n")
    with pytest.raises(UserMistake, match="cannot be read"):
        run(options)
