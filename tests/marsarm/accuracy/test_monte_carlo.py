"""`marsarm monte-carlo`: arms against the budget; result files, resumed runs, refused requests."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsw.config import configure
from marsarm.accuracy.budget import COMPONENTS, MOMENTS
from marsarm.accuracy.monte_carlo import Checkpoint, MonteCarloReport, check_coverage, run_monte_carlo
from marsarm.accuracy.monte_carlo_report import monte_carlo_document, monte_carlo_requirements
from marsarm.accuracy.request import MonteCarloRequest
from sim.arms import nominal_params
from sim.setting import World
from simgap.common.errors import BadRequest
from simgap.common.report import to_json
from tests.marsarm.command import marsarm

STATICS = MonteCarloRequest(arms=150, move_model="statics", seed=3, workers=1)


@pytest.fixture(scope="module")
def report() -> MonteCarloReport:
    return run_monte_carlo(STATICS)


@pytest.mark.slow
def test_the_papers_rule_and_the_worst_case_cover_everything_and_are_twice_as_wide(report):
    for rule in ("paper", "worst case"):
        for name in ("total_m", "lateral_m", "normal_m"):
            found = report.coverage.by_rule[rule][name]
            assert found.share == 1.0
            assert found.width > 2.0


@pytest.mark.slow
def test_ours_covers_what_it_should_and_is_hardly_wider(report):
    for name in COMPONENTS:
        found = report.coverage.by_rule[MOMENTS][name]
        assert found.holds(0.9973)
        assert 0.85 < found.width < 1.3


@pytest.mark.slow
def test_the_best_case_does_not_cover(report):
    assert not any(c.holds(0.9973) for c in report.coverage.by_rule["root sum square"].values())


@pytest.mark.slow
def test_errors_are_of_the_same_size_in_every_component_as_their_bounds(report):
    for name in COMPONENTS:
        within = report.coverage.budget.estimate(MOMENTS, name)
        assert 0.2 * within < np.sqrt(np.mean(report.coverage.error[name] ** 2)) < 0.7 * within


@pytest.mark.slow
def test_two_processes_measure_what_one_does(report):
    two = run_monte_carlo(replace(STATICS, arms=6, workers=2))
    for trial, same in zip(two.trials, report.trials[:6], strict=True):
        assert np.array_equal(trial[0].error, same[0].error)


@pytest.mark.slow
def test_a_run_that_was_killed_goes_on_where_it_was(report, tmp_path):
    path = tmp_path / "r.jsonl"
    run_monte_carlo(replace(STATICS, arms=4, results=path))
    path.write_bytes(path.read_bytes()[:-30])
    done = []
    more = run_monte_carlo(replace(STATICS, arms=8, results=path), lambda done_now, *_: done.append(done_now))
    assert done[0] == 3
    for trial, same in zip(more.trials, report.trials[:8], strict=True):
        assert np.array_equal(trial[0].error, same[0].error)


def test_the_closed_loop_measures_what_statics_do():
    loop = run_monte_carlo(MonteCarloRequest("mars", arms=2, move_model="closed-loop", seed=5, workers=1))
    statics = run_monte_carlo(MonteCarloRequest("mars", arms=2, move_model="statics", seed=5, workers=1))
    for a, b in zip(loop.trials, statics.trials, strict=True):
        # an output rests anywhere within its friction: 10 N m wind a gear by 0.1 mrad, 2 m from the tool
        assert np.linalg.norm((a[0].error - b[0].error)[3:]) < 2e-4


def test_an_arm_of_its_own_has_what_the_case_adds():
    found = run_monte_carlo(
        MonteCarloRequest("mars", "calibrated", arms=3, places=3, move_model="statics", seed=1, workers=1)
    )
    assert 1e-4 < found.coverage.percentile["total_m"] < 1e-2
    assert found.three_sigma["total_m"].accuracy.upper > found.three_sigma["total_m"].accuracy.estimate > 0


@pytest.mark.parametrize("arms", [1, 3])
def test_a_sample_that_is_too_small_for_a_bound_shows_nothing(arms):
    small = run_monte_carlo(replace(STATICS, case="mars", arms=arms, places=1))
    moved, *rows = monte_carlo_requirements(small)
    assert moved.passed
    assert len(rows) == 4
    assert not any(row.passed for row in rows)
    assert all(f"{arms} of 1365 arms" in row.value for row in rows if row.passed is None)


def test_a_sample_that_is_large_enough_shows_what_it_bounds():
    few = run_monte_carlo(replace(STATICS, case="mars", arms=5, places=1))
    trials = few.trials * 273
    found = check_coverage(few.model, "mars", configure(nominal_params()), World().gravity_N_m_s2, trials)
    enough = replace(few, trials=trials, coverage=found)
    assert [row.passed for row in monte_carlo_requirements(enough)] == [True] * 5
    assert all("1365 arms" in row.value for row in monte_carlo_requirements(enough)[1:])


@pytest.mark.slow
def test_an_interval_without_an_end_is_null_in_the_document(report):
    document = to_json(monte_carlo_document(report))
    assert document["coverage"]["percentile_interval"]["total_m"][1] is None
    json.dumps(document, allow_nan=False)


@pytest.mark.parametrize("line", ['{"x": 1}', '{"arm": 0, "places": [{}]}', "[]"])
def test_a_line_that_is_no_result_is_named(tmp_path, line):
    wanted = replace(STATICS, arms=1, results=tmp_path / "r.jsonl")
    run_monte_carlo(wanted)
    with wanted.results.open("a") as file:
        file.write(f"{line}\n")
    with pytest.raises(BadRequest, match="line 3 is no result"):
        run_monte_carlo(wanted)


def test_results_of_other_parameters_are_not_mixed_in(tmp_path):
    own = tmp_path / "own.toml"
    wanted = replace(STATICS, arms=1, params=own, results=tmp_path / "r.jsonl")
    own.write_text("[joints.elbow]\nspeed_rad_s = 0.01\n")
    run_monte_carlo(wanted)
    own.write_text("[joints.elbow]\nspeed_rad_s = 0.02\n")
    with pytest.raises(BadRequest, match="of another request"):
        run_monte_carlo(wanted)


def test_the_command_prints_one_document(tmp_path):
    words = ("monte-carlo", "--arms", "3", "--move-model", "statics", "--workers", "1", "--json")
    done = marsarm(tmp_path, *words, "--report", "page.html", "--results", "r.jsonl")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["arms"] == 3
    assert sorted(path.name for path in tmp_path.iterdir()) == ["page.html", "r.jsonl"]


ASKED = {"case": "mars", "seed": 1}


def written(path: Path, *results: dict) -> None:
    with Checkpoint(path, ASKED) as file:
        for result in results:
            file.add(result)


def test_what_was_written_is_there_again(tmp_path):
    path = tmp_path / "r.jsonl"
    written(path, {"arm": 0}, {"arm": 1})
    written(path, {"arm": 2})
    with Checkpoint(path, ASKED) as file:
        assert file.done == [{"arm": 0}, {"arm": 1}, {"arm": 2}]


@pytest.mark.parametrize("cut", range(1, 40))
def test_a_torn_line_is_forgotten_wherever_it_was_cut(tmp_path, cut):
    path = tmp_path / "r.jsonl"
    written(path, {"arm": 0}, {"arm": 1})
    whole = path.read_bytes()
    path.write_bytes(whole[:-cut])
    written(path, {"arm": 7})
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    assert lines[0] == {"request": ASKED}
    assert lines[-1] == {"arm": 7}
    kept = {"arm": 0} in lines, {"arm": 1} in lines
    assert kept == (cut <= len(b'{"arm": 1}\n'), False)


def test_results_of_another_request_are_refused_and_kept(tmp_path):
    path = tmp_path / "r.jsonl"
    written(path, {"arm": 0})
    before = path.read_bytes()
    with pytest.raises(BadRequest, match=r"of another request \(seed 1 there, 2 now\)"):
        Checkpoint(path, {**ASKED, "seed": 2})
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("arm,error\n0,1\n", "holds something else"),
        ('{"request": 1\n', "line 1 is not JSON"),
        ("hello", "holds something else"),
        ('{"arm": 0}\n', "holds something else"),
        ('{"request": {"case": "mars", "seed": 1}}\n[1]\n', "line 2 is no result"),
        ('{"request": {"case": "mars", "seed": 1}}\n{"ar\n{"arm": 1}\n', "line 2 is not JSON"),
    ],
)
def test_a_file_of_something_else_is_refused_and_kept(tmp_path, text, words):
    path = tmp_path / "r.jsonl"
    path.write_text(text)
    with pytest.raises(BadRequest, match=words):
        Checkpoint(path, ASKED)
    assert path.read_text() == text


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(BadRequest, match="cannot be written"):
        Checkpoint(tmp_path / "no" / "r.jsonl", ASKED)
