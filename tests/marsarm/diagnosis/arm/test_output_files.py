"""Findings as a patch for the simulator and as flight parameters."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from marsarm.common.effects import parse_effects
from marsarm.diagnosis.arm.output_files import (
    NothingToWrite,
    effects_of_findings,
    new_params,
    params_text,
    patch_text,
)
from marsarm.diagnosis.arm.simulator import list_hypotheses
from sim.arms import nominal_params, params_over_nominal
from sim.effects.gears import CoulombFriction
from sim.effects.joints import GearStiffness
from tests.tools import TOOLS


@pytest.fixture
def softer(results):
    """Return a diagnosis with a softer gear."""
    (one,) = (one for one in list_hypotheses(None) if one.key == "elbow: gear-stiffness")
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
