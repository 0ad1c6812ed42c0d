"""Files and score of the pairs of logs of one robot, before and after."""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simgap.loading import load
from validation.cases.pairs import CHANGES, KIND_SHARES, RobotPairs, SealedPair, score_pairs
from validation.cases.robot import plan_robot_cases, write_robot
from validation.cases.robot_draw import DrawnEffect, Truth
from validation.cases.robot_setup import ARMS, HELD_OUT, PLAN, load_robot
from validation.cases.robot_table import list_hypotheses

ZERO = DrawnEffect("joint zero", "swing", "sensing and timing", 0.1, 0.5, 4.0, ("sensing and timing",))


def pair(*changes: DrawnEffect, is_gone: bool = False) -> SealedPair:
    truth = Truth("pendulum", "single" if changes else "none", 11, changes, {})
    return SealedPair("case-000", truth, tuple(((one.name, one.place),) for one in changes), (), is_gone)


def result(*effects: str) -> dict[str, Any]:
    findings = [
        {"place": "swing", "effect": one, "places": ["swing"], "families": [], "effects": [f"swing: {one}"]}
        for one in effects
    ]
    return {"findings": findings, "seconds": 1.0, "refused": ""}


def count_hits(*solved: tuple[SealedPair, dict[str, Any]]) -> list[int]:
    return [one["hits"] for one in score_pairs(solved).document["bars"].values()]


def test_of_forty_pairs_sixteen_have_no_change() -> None:
    plans = plan_robot_cases(40, 7, tuple(ARMS), KIND_SHARES)
    assert Counter(one.kind for one in plans) == {"none": 16, "single": 24}


def test_the_numbers_of_every_joint_may_change() -> None:
    changing = {one.place for one in list_hypotheses(load_robot("four_joint"), CHANGES)}
    friction = [one for one in list_hypotheses(load_robot("four_joint"), CHANGES) if "Coulomb" in one.key]
    assert {one.place for one in friction} == {joint.name for joint in load_robot("four_joint").joints}
    assert "supply" in changing


@pytest.mark.slow
@pytest.mark.parametrize("is_gone", [False, True])
def test_both_logs_have_the_same_commands_and_one_of_them_the_change(tmp_path: Path, is_gone: bool) -> None:
    RobotPairs(("pendulum",)).record(tmp_path / "case-000", pair(ZERO, is_gone=is_gone))
    write_robot(tmp_path, load_robot("pendulum"), HELD_OUT, tuple(name for name, _ in PLAN))
    before, after = (
        load(tmp_path / "robot.toml", tmp_path / "case-000" / f"{name}.parquet").motions
        for name in ("before", "after")
    )
    assert [one.name for one in before] == [name for name, _ in PLAN if name not in HELD_OUT]
    pairs = [(a.joints["swing"], b.joints["swing"]) for a, b in zip(before, after, strict=True)]
    assert all(np.array_equal(a.command.value, b.command.value) for a, b in pairs if a.command and b.command)
    change = np.mean([b.position.value - a.position.value for a, b in pairs])
    assert change == pytest.approx(-0.1 if is_gone else 0.1, rel=0.2)
    assert not any(np.array_equal(a.position.value, b.position.value) for a, b in pairs)


def test_a_change_counts_by_its_place_and_its_effect() -> None:
    assert count_hits((pair(), result()), (pair(ZERO), result("joint zero"))) == [0, 1, 1]
    assert count_hits((pair(), result("backlash")), (pair(ZERO), result())) == [1, 0, 0]
