"""Families of effects, and effects that make the drawing the arm of flight parameters."""

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from fsw.kinematics.arm import transform6_to_pose
from marsarm.diagnosis.arm.arm_effects import FAMILIES, effects_of_params, list_hypotheses
from marsarm.diagnosis.arm.audit import load_checked_recordings
from marsarm.diagnosis.arm.diagnose_logs import _read_params
from marsarm.diagnosis.arm.logs import NotForDiagnosis
from marsarm.diagnosis.arm.record import PARAMS_FILE
from marsarm.diagnosis.arm.request import DiagnoseRequest
from sim.arm_model.load import default_arm
from sim.arms import arm_named, nominal_params, params_over_nominal
from sim.effects.effect import params_with_effects
from sim.params import params_table
from tests.marsarm.command import marsarm


def numbers(table: object) -> list[float]:
    if isinstance(table, dict):
        return [x for value in table.values() for x in numbers(value)]
    if isinstance(table, list | tuple):
        return [x for value in table for x in numbers(value)]
    return [float(table)] if isinstance(table, int | float) else []


@pytest.mark.parametrize("seed", [1, 2, 7])
def test_the_parameters_of_a_calibrated_arm_come_back_from_its_effects(seed: int) -> None:
    params = arm_named(f"calibrated:{seed}").params
    found = params_with_effects(effects_of_params(params, nominal_params()), nominal_params())
    for one, other in zip(found.links.in_order(), params.links.in_order(), strict=True):
        X, Y = transform6_to_pose(one.transform), transform6_to_pose(other.transform)
        np.testing.assert_allclose(X.R, Y.R, atol=1e-12)
        np.testing.assert_allclose(X.p, Y.p, atol=1e-12)
        largest = np.max(np.abs(other.compliance))
        np.testing.assert_allclose(one.compliance, other.compliance, atol=1e-6 * largest)
        np.testing.assert_allclose(one.far.com_m, other.far.com_m, atol=1e-9)
        np.testing.assert_allclose(one.near.com_m, other.near.com_m, atol=1e-6)
        np.testing.assert_allclose(one.near.mass_kg, other.near.mass_kg, rtol=1e-12)
        np.testing.assert_allclose(one.far.mass_kg, other.far.mass_kg, rtol=1e-12)
    ours, theirs = (numbers(params_table(one)["joints"]) for one in (found, params))
    np.testing.assert_allclose(ours, theirs, rtol=1e-12)


def test_the_drawing_has_no_effects() -> None:
    assert effects_of_params(nominal_params(), nominal_params()) == ()


def test_logs_of_a_calibrated_arm_are_diagnosed_with_the_parameters_beside_them(tmp_path: Path) -> None:
    words = ("--out", "logs", "--arm", "calibrated:7", "--sessions", "poses-level-[15]", "--json")
    named = json.loads(marsarm(tmp_path, "gap", "record", *words).stdout)["logs"]
    assert named == ["logs/poses-level-1.mcap", "logs/held-out/poses-level-5.mcap"]
    logs = [tmp_path / path for path in named]
    known = arm_named("calibrated:7").params
    assert params_over_nominal(tmp_path / "logs" / PARAMS_FILE) == known
    assert _read_params(DiagnoseRequest((tmp_path / "logs",)), tmp_path / "logs", default_arm()) == known
    assert load_checked_recordings(logs, known)[0].params == known
    with pytest.raises(NotForDiagnosis) as found:
        load_checked_recordings(logs, nominal_params())
    assert len(str(found.value).splitlines()) == 1
    assert str(found.value).startswith("2 of 2 logs were made with other flight parameters")


def test_every_candidate_has_one_family() -> None:
    count = Counter(kind for kinds in FAMILIES.values() for kind in kinds)
    assert set(count.values()) == {1}
    every = [*list_hypotheses()]
    assert {one.entry.kind for one in every if one.entry is not None} == set(count)
    assert {one.family for one in every} == set(FAMILIES)
