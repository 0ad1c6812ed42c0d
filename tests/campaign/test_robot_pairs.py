"""Files and score of the pairs of logs of one robot, before and after."""

from collections import Counter

import numpy as np
import pyarrow.parquet as pq
import pytest

from validation.cases.pairs import CHANGES, KIND_SHARES, RobotPairs, SealedPair, score_pairs
from validation.cases.robot import plan_robot_cases
from validation.cases.robot_draw import DrawnEffect, Truth
from validation.cases.robot_setup import ARMS, HELD_OUT, PLAN, load_robot
from validation.cases.robot_table import list_hypotheses

CLAMP = DrawnEffect("command clamp, high", "swing", "actuation", 0.3, 0.5, 4.0, ("actuation",))


def pair(*changes, is_gone=False):
    truth = Truth("pendulum", "single" if changes else "none", 11, changes, {})
    return SealedPair("case-000", truth, tuple(((one.name, one.place),) for one in changes), (), is_gone)


def result(*effects):
    alike = {"place": "swing", "places": ["swing"], "families": []}
    findings = [alike | {"effect": one, "effects": [f"swing: {one}"]} for one in effects]
    return {"findings": findings, "seconds": 1.0, "refused": ""}


def count_hits(*solved):
    return [one["hits"] for one in score_pairs(solved).document["bars"].values()]


def test_of_forty_pairs_sixteen_have_no_change():
    plans = plan_robot_cases(40, 7, tuple(ARMS), KIND_SHARES)
    assert Counter(one.kind for one in plans) == {"none": 16, "single": 24}


def test_the_numbers_of_every_joint_may_change():
    changing = {one.place for one in list_hypotheses(load_robot("four_joint"), CHANGES)}
    friction = [one for one in list_hypotheses(load_robot("four_joint"), CHANGES) if "Coulomb" in one.key]
    assert {one.place for one in friction} == {joint.name for joint in load_robot("four_joint").joints}
    assert "supply" in changing


@pytest.mark.slow
@pytest.mark.parametrize("is_gone", [False, True])
def test_both_logs_have_the_same_commands_and_one_of_them_the_change(tmp_path, is_gone):
    RobotPairs(("pendulum",)).record(tmp_path / "case-000", pair(CLAMP, is_gone=is_gone))
    paths = (tmp_path / "case-000" / f"{name}.parquet" for name in ("before", "after"))
    before, after = (pq.read_table(path).to_pydict() for path in paths)
    assert set(before["motion"]) == {name for name, _ in PLAN} - HELD_OUT
    assert all(before[name] == after[name] for name in ("motion", "repeat", "t_s", "command_swing"))
    highest = [np.max(one["position_swing"]) for one in (before, after)]
    assert highest[is_gone] - highest[not is_gone] > 0.5 * CLAMP.size


def test_a_change_counts_by_its_place_and_its_effect():
    assert count_hits((pair(), result()), (pair(CLAMP), result("command clamp, high"))) == [0, 1, 1]
    assert count_hits((pair(), result("backlash")), (pair(CLAMP), result())) == [1, 0, 0]
