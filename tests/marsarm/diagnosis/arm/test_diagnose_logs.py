"""Request of a diagnosis; its findings as a patch and as flight parameters; effects of flight parameters."""

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from fsw.kinematics.arm import transform6_to_pose
from marsarm.common.requests import parse_effects
from marsarm.diagnosis.arm.arm_effects import FAMILIES, effects_of_params, list_hypotheses
from marsarm.diagnosis.arm.audit import load_checked_recordings
from marsarm.diagnosis.arm.diagnose_logs import (
    NothingToWrite,
    _read_params,
    diagnose,
    effects_of_findings,
    expand_logs,
    params_text,
    patch_text,
)
from marsarm.diagnosis.arm.logs import NotForDiagnosis
from marsarm.diagnosis.arm.record import PARAMS_FILE
from marsarm.diagnosis.arm.request import DiagnoseRequest
from sim.arm_model.load import default_arm
from sim.arms import arm_named, nominal_params, params_over_nominal
from sim.effects.effect import params_with_effects
from sim.effects.joints import GearStiffness
from sim.params import params_table
from simgap.common.errors import BadRequest
from tests.marsarm.command import marsarm
from tests.tools import TOOLS


@pytest.fixture
def folder(tmp_path):
    """Create two empty logs, and one elsewhere."""
    (tmp_path / "logs").mkdir()
    for name in ("b", "a"):
        (tmp_path / "logs" / f"{name}.mcap").write_text(name)
    (tmp_path / "logs" / "a.tracker.csv").write_text("")
    (tmp_path / "other.mcap").write_text("other")
    (tmp_path / "empty").mkdir()
    return tmp_path


def test_a_folder_is_all_logs_in_it(folder):
    logs = expand_logs((folder / "logs", folder / "other.mcap"), "log")
    assert [path.name for path in logs] == ["a.mcap", "b.mcap", "other.mcap"]


@pytest.mark.parametrize(
    ("logs", "held_out", "options", "said"),
    [
        (["empty"], [], {}, r"log .*empty: this folder holds no \.mcap file"),
        (["logs"], ["n" * 300], {}, "there is no such log or a folder"),
        (
            ["logs"],
            ["/dev/null"],
            {},
            "held-out log /dev/null: is not a regular file; give a log or a folder",
        ),
        (["logs"], [], {"catalogue": "sensor-fault"}, "'sensor-fault' is no effect"),
        (["logs"], [], {"campaign": "none"}, "campaign .*none: there is no such folder"),
    ],
)
def test_what_is_wrong_is_refused(folder, logs, held_out, options, said):
    paths = [tuple(folder / path for path in some) for some in (logs, held_out)]
    options = {name: folder / text if name == "campaign" else text for name, text in options.items()}
    with pytest.raises(BadRequest, match=said):
        diagnose(DiagnoseRequest(*paths, **options))


def diagnosed(results, key, value):
    """Return a diagnosis of the effect of this key, whose first parameter has this value."""
    (one,) = (one for one in list_hypotheses() if one.key == key)
    first = one.parameters[0]
    return replace(results["alike"], effects=(one,), sizes=(((value - first.neutral) / first.typical,),))


@pytest.fixture
def softer(results):
    """Return a diagnosis with a softer gear."""
    return diagnosed(results, "elbow: gear-stiffness", float(np.log(0.8)))


def test_a_finding_is_the_effect_of_the_size_that_was_found_and_the_patch_switches_it_on(softer, tmp_path):
    assert effects_of_findings(softer) == (GearStiffness(Joint.ELBOW, pytest.approx(0.8)),)
    (tmp_path / "found.toml").write_text(patch_text(softer))
    assert parse_effects((str(tmp_path / "found.toml"),), TOOLS) == effects_of_findings(softer)


def test_flight_parameters_know_what_was_found(softer, tmp_path):
    (tmp_path / "new.toml").write_text(params_text(softer, nominal_params(), nominal_params()))
    read = params_over_nominal(tmp_path / "new.toml")
    softened = nominal_params().joints.elbow.gear_stiffness_Nm_rad * 0.8
    assert read.joints.elbow.gear_stiffness_Nm_rad == pytest.approx(softened)


def test_without_a_name_or_a_flight_parameter_there_is_no_file(results):
    with pytest.raises(NothingToWrite, match="no effect was found"):
        patch_text(results["unknown"])
    with pytest.raises(NothingToWrite, match="no flight parameter for coulomb-friction:elbow"):
        params_text(diagnosed(results, "elbow: coulomb-friction", 5.0), nominal_params(), nominal_params())


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
