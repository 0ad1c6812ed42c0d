"""Sealing, files and score of the cases of any robot, and of pairs of logs of one robot."""

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from helpers.real_robots import exchange_commands
from marsarm.common.pool import run_here
from marsarm.common.rates import check_rate
from simgap.common.errors import RobotError
from simgap.common.progress import no_progress
from simgap.diagnosis import diagnose
from simgap.loading import load
from simgap.logs import JointLog, Logs, Motion, Signal
from validation.cases import robot as robot_cases
from validation.cases import sealed
from validation.cases.robot_draw import DrawnEffect, Truth, draw_case
from validation.cases.robot_score import SealedCase, score_cases
from validation.cases.robot_setup import ARMS, HELD_OUT, PLAN, load_robot, sample_times, write_robot
from validation.cases.robot_table import list_hypotheses

MAKER = robot_cases.RobotCases(("pendulum",))
DELAY = DrawnEffect("command delay", "swing", "sensing and timing", 0.004, 0.5, 2.0, ("sensing and timing",))
CREEP = DrawnEffect("creeping link", "swing", "transmission", 0.01, 0.5, 2.0, ("geometry", "transmission"))


def case(kind, *effects):
    same = tuple(((one.name, one.place),) if one is DELAY else () for one in effects)
    return SealedCase("case-000", Truth("pendulum", kind, 1000, effects, {}), same)


def finding(effect, family, *others):
    keys = [f"swing: {name}" for name in (effect, *others)]
    finding = {"place": "swing", "family": family, "effect": effect}
    return finding | {"places": ["swing"], "families": [family], "effects": keys}


def result(*findings):
    return {"findings": list(findings), "seconds": 10.0, "refused": ""}


TRUE_DELAY = finding("command delay", "sensing and timing", "measurement delay")
FRICTION = finding("Stribeck friction", "friction")


def test_what_was_sealed_comes_back(tmp_path):
    digest = sealed.seal(tmp_path, sealed.SealedTruth("salt", (case("single", DELAY),)))
    assert sealed.load_truth(tmp_path, MAKER).digest() == digest


def test_a_hundred_and_twenty_cases_have_their_kinds_and_models_in_equal_parts():
    plans = robot_cases.plan_robot_cases(120, 7, ("pendulum", "two_joint", "four_joint"))
    assert Counter(one.kind for one in plans) == {"none": 36, "single": 36, "pair": 24, "outside": 24}
    assert set(Counter((one.kind, one.model) for one in plans).values()) == {12, 8}
    assert min(one.seed for one in plans) >= 1000


def test_solving_reads_nothing_of_the_truth_and_goes_on_where_it_was_stopped(tmp_path, monkeypatch):
    (tmp_path / "cases").mkdir()
    (tmp_path / robot_cases.INDEX_FILE).write_text(
        json.dumps({"case-000": "pendulum", "case-001": "pendulum"})
    )
    for name in ("case-000", "case-001"):
        sealed.case_path(tmp_path, MAKER, name).touch()
    (tmp_path / "digest.txt").write_text("00")
    sealed.write_json(sealed.result_path(tmp_path, "case-000"), result())

    class Nothing:
        findings = remaining = errors = refused = ()

    seen: list[Path] = []
    diagnosed = lambda *paths: seen.extend(paths[:2]) or Nothing()  # noqa: E731
    monkeypatch.setattr(robot_cases, "diagnose_files", diagnosed)
    assert sealed.solve_cases(tmp_path, MAKER, run_here, no_progress) == (1, 2)
    names = [path.relative_to(tmp_path).as_posix() for path in seen]
    assert names == ["robots/pendulum/robot.toml", "cases/case-001.parquet"]


def test_a_right_answer_meets_all_bars():
    solved = [(case("none"), result()), (case("single", DELAY), result(TRUE_DELAY))]
    solved.append((case("outside", CREEP), result()))
    found = score_cases(solved).document
    assert all(bar["met"] for bar in found["bars"].values())
    assert found["bars"]["right effect"]["hits"] == 1
    assert found["mean set size"] == 2


def test_a_wrong_name_of_an_outside_effect_counts_at_each_level_that_it_gives():
    only_place = {**FRICTION, "families": [], "effects": []}
    for found, wrong in ((FRICTION, [0, 1, 1]), (only_place, [0, 0, 0])):
        bars = score_cases([(case("outside", CREEP), result(found))]).document["bars"]
        assert [bars[f"outside, wrong {level}"]["hits"] for level in sealed.LEVELS] == wrong


def test_effects_below_the_limit_are_not_counted_as_missed():
    small = replace(DELAY, times_limit=0.9)
    truth = Truth("pendulum", "single", 1000, (small,), {})
    secret = SealedCase("case-000", truth, ((("command delay", "swing"),),))
    assert score_cases([(secret, result())]).document["bars"]["reported"]["of"] == 0


@pytest.mark.parametrize(("of", "rate", "most"), [(36, 0.05, 4), (24, 0.05, 3), (24, 0.10, 5), (24, 0.15, 7)])
def test_the_counts_of_the_bars_are_those_of_an_exact_test(of, rate, most):
    counts = [[True] * hits + [False] * (of - hits) for hits in (most, most + 1)]
    verdicts = [check_rate(one, rate, True).is_met for one in counts]
    assert verdicts == [True, False]


def test_files_of_a_case_hold_commands_positions_and_temperatures_alone(tmp_path):
    times = sample_times()
    signal = Signal(times, np.sin(times))
    joint = JointLog(position=signal, command=signal, temperature=signal)
    motions = tuple(Motion(name, {"swing": joint}, {"swing": 1.0}) for name, _ in PLAN)
    robot_file = write_robot(tmp_path / "robot", "pendulum")
    robot_cases.write_logs(tmp_path / "log.parquet", Logs(motions, HELD_OUT))
    table = pq.read_table(tmp_path / "log.parquet")
    columns = "motion repeat t_s command_swing position_swing temperature_swing"
    assert table.column_names == columns.split()
    assert not table.schema.metadata
    read = load(robot_file, tmp_path / "log.parquet")
    assert (len(read.fit), len(read.judged)) == (8, 4)
    assert read.motions[3].joints["swing"].position.value == pytest.approx(signal.value)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_case():
    first, second = (draw_case(11, "none", "pendulum")[1] for _ in range(2))
    pairs = zip(first.motions, second.motions, strict=True)
    assert all((a.joints["swing"].position.value == b.joints["swing"].position.value).all() for a, b in pairs)


@pytest.mark.slow
def test_motions_with_the_commands_of_others_are_not_fitted():
    robot, logs, _ = draw_case(0, "single", "pendulum")
    try:
        found = diagnose(robot, exchange_commands(logs.motions, 0), seed=0)
    except RobotError:
        return
    assert (found.findings, found.fitted_motions) == ((), ())


CLAMP = DrawnEffect("command clamp, high", "swing", "actuation", 0.3, 0.5, 4.0, ("actuation",))


def pair(*changes, is_gone=False):
    truth = Truth("pendulum", "single" if changes else "none", 11, changes, {})
    return robot_cases.SealedPair(
        "case-000", truth, tuple(((one.name, one.place),) for one in changes), (), is_gone
    )


def changes_of(*effects):
    alike = {"place": "swing", "places": ["swing"], "families": []}
    findings = [alike | {"effect": one, "effects": [f"swing: {one}"]} for one in effects]
    return {"findings": findings, "seconds": 1.0, "refused": ""}


def count_hits(*solved):
    return [one["hits"] for one in robot_cases.score_pairs(solved).document["bars"].values()]


def test_of_forty_pairs_sixteen_have_no_change():
    plans = robot_cases.plan_robot_cases(40, 7, tuple(ARMS), robot_cases.PAIR_SHARES)
    assert Counter(one.kind for one in plans) == {"none": 16, "single": 24}


def test_the_numbers_of_every_joint_may_change():
    changing = {one.place for one in list_hypotheses(load_robot("four_joint"), robot_cases.CHANGES)}
    friction = [
        one for one in list_hypotheses(load_robot("four_joint"), robot_cases.CHANGES) if "Coulomb" in one.key
    ]
    assert {one.place for one in friction} == {joint.name for joint in load_robot("four_joint").joints}
    assert "supply" in changing


@pytest.mark.slow
@pytest.mark.parametrize("is_gone", [False, True])
def test_both_logs_have_the_same_commands_and_one_of_them_the_change(tmp_path, is_gone):
    robot_cases.RobotPairs(("pendulum",)).record(tmp_path / "case-000", pair(CLAMP, is_gone=is_gone))
    paths = (tmp_path / "case-000" / f"{name}.parquet" for name in ("before", "after"))
    before, after = (pq.read_table(path).to_pydict() for path in paths)
    assert set(before["motion"]) == {name for name, _ in PLAN} - HELD_OUT
    assert all(before[name] == after[name] for name in ("motion", "repeat", "t_s", "command_swing"))
    highest = [np.max(one["position_swing"]) for one in (before, after)]
    assert highest[is_gone] - highest[not is_gone] > 0.5 * CLAMP.size


def test_a_change_counts_by_its_place_and_its_effect():
    assert count_hits((pair(), changes_of()), (pair(CLAMP), changes_of("command clamp, high"))) == [0, 1, 1]
    assert count_hits((pair(), changes_of("backlash")), (pair(CLAMP), changes_of())) == [1, 0, 0]
