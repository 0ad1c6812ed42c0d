"""Request of a diagnosis, and its findings as a patch for the simulator and as flight parameters."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from marsarm.common.effects import parse_effects
from marsarm.diagnosis.arm.arm_effects import list_hypotheses
from marsarm.diagnosis.arm.diagnose_logs import (
    NothingToWrite,
    diagnose,
    effects_of_findings,
    expand_logs,
    new_params,
    params_text,
    patch_text,
)
from marsarm.diagnosis.arm.request import DiagnoseRequest
from sim.arms import nominal_params, params_over_nominal
from sim.effects.gears import CoulombFriction
from sim.effects.joints import GearStiffness
from simgap.common.errors import BadRequest
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
        (["logs"], ["n" * 300], {}, "there is no such log or folder"),
        (["logs"], ["/dev/null"], {}, "held-out log /dev/null: is not a regular file; give log or folder"),
        (["logs"], [], {"catalogue": "sensor-fault"}, "'sensor-fault' is no effect"),
        (["logs"], [], {"campaign": "none"}, "campaign .*none: there is no such folder"),
    ],
)
def test_what_is_wrong_is_refused(folder, logs, held_out, options, said):
    paths = [tuple(folder / path for path in some) for some in (logs, held_out)]
    options = {name: folder / text if name == "campaign" else text for name, text in options.items()}
    with pytest.raises(BadRequest, match=said):
        diagnose(DiagnoseRequest(*paths, **options))


@pytest.fixture
def softer(results):
    """Return a diagnosis with a softer gear."""
    (one,) = (one for one in list_hypotheses() if one.key == "elbow: gear-stiffness")
    size = float(np.log(0.8)) / one.parameters[0].typical
    return replace(results["alike"], effects=(one,), sizes=((size,),))


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
        new_params(nominal_params(), (CoulombFriction(Joint.ELBOW, 5.0),))
