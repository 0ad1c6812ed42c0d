"""`marsarm monte-carlo`: arms against the budget; its trials, each source in them, refused requests."""

import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsw.config import configure
from fsw.dictionary.enums import Frame, Joint
from fsw.kinematics.transforms import Array, Pose
from helpers.marks import slow_but
from marsarm.accuracy import trial
from marsarm.accuracy.budget import COMPONENTS, MOMENTS
from marsarm.accuracy.monte_carlo import Checkpoint, MonteCarloReport, check_coverage, run_monte_carlo
from marsarm.accuracy.monte_carlo_report import monte_carlo_document, monte_carlo_requirements
from marsarm.accuracy.propagation import Poses, Sensitivity, compute_sensitivity, load_error_model
from marsarm.accuracy.request import MonteCarloRequest
from sim.arms import BuiltArm, arm_named, nominal_params
from sim.avionics import move_rng
from sim.effects.effect import EachMove, Effect, draw_move_disturbance
from sim.effects.geometry import Expansion, FrameError
from sim.effects.joints import BacklashWidth, GearStiffness, HardstopAngle
from sim.initialisation import true_reference
from sim.loop import hardware_rng
from sim.record import frame_body
from sim.setting import World
from simgap.common.errors import BadRequest
from simgap.common.report import to_json
from tests.marsarm.command import marsarm_json

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
    for one, same in zip(two.trials, report.trials[:6], strict=True):
        assert np.array_equal(one[0].error, same[0].error)


@pytest.mark.slow
def test_a_run_that_was_killed_goes_on_where_it_was(report, tmp_path):
    path = tmp_path / "r.jsonl"
    run_monte_carlo(replace(STATICS, arms=4, results=path))
    path.write_bytes(path.read_bytes()[:-30])
    done = []
    more = run_monte_carlo(replace(STATICS, arms=8, results=path), lambda done_now, *_: done.append(done_now))
    assert done[0] == 3
    for one, same in zip(more.trials, report.trials[:8], strict=True):
        assert np.array_equal(one[0].error, same[0].error)


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
    words = ("monte-carlo", "--arms", "3", "--move-model", "statics", "--workers", "1")
    document = marsarm_json(tmp_path, *words, "--report", "page.html", "--results", "r.jsonl")
    assert document["arms"] == 3
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


MODEL = load_error_model()
NOMINAL = arm_named("nominal")
CONFIG = configure(NOMINAL.params)
TOOL = "mahli"
PLACE = trial.random_placements(CONFIG, TOOL, 1, np.random.SeedSequence(4))[0]
LARGER = {"slop": 20.0, "wobble": 10.0, "encoder": 10.0, "distortion_gradient": 5.0, "motor_controller": 5.0}
"""Factors that make errors larger than the other errors of the plant."""
CLOSE_M, CLOSE_RAD, CLOSE_SHARE = 3e-5, 4e-5, 0.02
LOAD_MOVES_SHARE = 0.08
"""Tolerance for the change of the load on a softer arm, which the paper's equation 9 neglects."""
MOVING = sorted(set(MODEL.source) - {"backlash", "deflection"})
QUICK = ("assembly", "encoder", "rover_stiffness", "distortion_bulk")
"""Sources of `make test`: one of each kind of effect in the plant."""


def effects(name: str) -> list[Effect]:
    rng = np.random.default_rng([5, len(name)])
    return list(trial.sample_source(MODEL.source[name], LARGER.get(name, 1.0), TOOL, rng))


def here() -> Sensitivity:
    poses = Poses(TOOL, PLACE.output_rad[:, None], np.zeros((3, 1)))
    return compute_sensitivity(CONFIG, poses, World().gravity_N_m_s2)


def predicted(found: Iterable[Effect], gap: Array) -> Array:
    """Predict the screw in tool axes, shape (6,), from the sensitivities and the sampled effects."""
    found, moved = list(found), here()
    theta, shares = np.zeros((6, len(Frame))), np.zeros(len(Frame))
    by_chance = draw_move_disturbance(
        [effect for effect in found if isinstance(effect, EachMove)], move_rng(hardware_rng(PLACE.seed))
    )
    theta += np.array([by_chance.screw(frame_body(frame, TOOL)) for frame in Frame]).T
    theta[trial.Z_TURN, : len(Joint)] += by_chance.gear_rad + by_chance.motor_rad
    for effect in found:
        match effect:
            case FrameError(frame, screw):
                theta[:, frame] += screw
            case HardstopAngle(joint, shift_rad):
                theta[trial.Z_TURN, joint] += shift_rad
            case GearStiffness(joint, factor):
                shares[joint] += 1 / factor - 1
            case BacklashWidth(joint, factor):
                theta[trial.Z_TURN, joint] += (
                    (factor - 1) * gap[joint] * MODEL.source["backlash"].theta[2, joint]
                )
    warming = np.zeros(len(Frame))
    for effect in found:
        if isinstance(effect, Expansion):
            warming[effect.frame] = -MODEL.source["distortion_bulk"].warming_K * (effect.factor - 1)
    u = np.einsum("ikj,kj->i", moved.J[..., 0], theta)
    return u + moved.deflection[..., 0] @ shares + moved.expansion_1_K[..., 0] @ warming


def where(*found: Effect, backlash: str = "on") -> tuple[Pose, Array]:
    arm = BuiltArm("tried", tuple(found), NOMINAL.params)
    # nominal backlash, whatever the true backlash is
    known = NOMINAL if any(isinstance(effect, BacklashWidth) for effect in found) else arm
    return trial.closed_loop_model(arm, true_reference(known), backlash)(PLACE)


@pytest.fixture(scope="module")
def nominal() -> tuple[Pose, Array]:
    return where()


def check(u: Array, expected: Array, share: float = CLOSE_SHARE) -> None:
    turn, shift = u[1:3] - expected[1:3], u[3:] - expected[3:]
    assert np.linalg.norm(shift) < CLOSE_M + share * np.linalg.norm(expected[3:])
    assert np.linalg.norm(turn) < CLOSE_RAD + share * np.linalg.norm(expected[1:3])


@pytest.mark.parametrize("name", slow_but(MOVING, *QUICK))
def test_a_source_moves_the_tool_by_what_its_sensitivity_says(name, nominal):
    found = effects(name)
    X_RT, gap = where(*found)
    expected = predicted(found, gap)
    assert np.linalg.norm(expected[3:]) > 2 * CLOSE_M
    check(trial.error_in_tool(nominal[0], X_RT), expected)


@pytest.mark.slow
def test_softer_springs_move_the_tool_by_their_share_of_the_deflection(nominal):
    found = effects("deflection")
    X_RT, gap = where(*found)
    check(trial.error_in_tool(nominal[0], X_RT), predicted(found, gap), LOAD_MOVES_SHARE)


@pytest.mark.slow
def test_a_gap_that_is_wider_than_believed_moves_the_tool_by_what_is_not_allowed_for(nominal):
    found = list(trial.sample_source(MODEL.source["backlash"], 0.1, TOOL, np.random.default_rng(6)))
    X_RT, gap = where(*found)
    check(trial.error_in_tool(nominal[0], X_RT), predicted(found, gap))


def test_a_gap_that_nothing_allows_for_moves_the_tool_by_the_side_that_every_output_lies_on(nominal):
    X_RT, gap = where(backlash="off")
    theta = MODEL.source["backlash"].theta[2]
    expected = here().J[:, 2, :, 0] @ (theta * np.append(gap, [0.0, 0.0]))
    assert np.abs(gap).min() > 0.999
    check(trial.error_in_tool(nominal[0], X_RT), expected)


@pytest.mark.parametrize(
    ("case", "seed"), slow_but([("accuracy", 1), ("mars", 1), ("accuracy", 2), ("mars", 2)], ("mars", 1))
)
def test_statics_end_where_the_closed_loop_does(case, seed):
    found = trial.sample_effects(MODEL, MODEL.case[case], TOOL, np.random.default_rng(seed))
    arm = BuiltArm("drawn", found, NOMINAL.params)
    believed = trial.configure_believed(arm)
    place = trial.random_placements(believed, TOOL, 1, np.random.SeedSequence(seed))[0]
    backlash = "off" if case == "accuracy" else "on"
    reference = true_reference(arm)
    reference.half_backlash_rad[:] = true_reference(NOMINAL).half_backlash_rad
    statics = trial.statics_model(arm, believed, backlash)(place)
    loop = trial.closed_loop_model(arm, reference, backlash)(place)
    apart = trial.error_in_tool(statics[0], loop[0])
    assert np.linalg.norm(apart[3:]) < 1e-4
    assert np.allclose(statics[1], loop[1], atol=0.01)


@pytest.mark.slow
def test_as_built_arms_are_10_to_20_mm_off():
    """Use 100 arms at two placements each, so that a few good arms cannot decide."""
    squares_m2 = []
    for seed in range(100):
        arm = arm_named(f"as-built:{seed}")
        believed = trial.configure_believed(arm)
        places = trial.random_placements(believed, "apxs", 2, np.random.SeedSequence(seed))
        found = trial.measure_placements(trial.statics_model(arm, believed, "on"), places)
        squares_m2 += [one.error[3:] @ one.error[3:] for one in found]
    assert 10e-3 < np.sqrt(np.mean(squares_m2)) < 20e-3
