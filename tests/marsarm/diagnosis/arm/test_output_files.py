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
    save_new_params,
    save_patch,
)
from sim.arms import nominal_params, params_over_nominal
from sim.effects.gears import CoulombFriction
from sim.effects.joints import GearStiffness
from tests.tools import TOOLS


@pytest.fixture
def softer(results):
    """Return a diagnosis with a softer gear."""
    (finding,) = results["alike"].findings
    found = replace(finding, place="elbow", effect="gear-stiffness", size=(np.log(0.8),))
    return replace(results["alike"], findings=(found,))


def test_a_finding_is_the_effect_of_the_size_that_was_found_and_the_patch_switches_it_on(softer, tmp_path):
    assert effects_of_findings(softer) == (GearStiffness(Joint.ELBOW, pytest.approx(0.8)),)
    save_patch(softer, tmp_path / "found.toml")
    assert parse_effects((str(tmp_path / "found.toml"),), TOOLS) == effects_of_findings(softer)


def test_flight_parameters_know_what_was_found(softer, tmp_path):
    save_new_params(softer, nominal_params(), nominal_params(), tmp_path / "new.toml")
    read = params_over_nominal(tmp_path / "new.toml")
    softened = nominal_params().joints.elbow.gear_stiffness_Nm_rad * 0.8
    assert read.joints.elbow.gear_stiffness_Nm_rad == pytest.approx(softened)


def test_without_a_name_or_a_flight_parameter_there_is_no_file(results, tmp_path):
    with pytest.raises(NothingToWrite, match="no effect was found"):
        save_patch(results["unknown"], tmp_path / "found.toml")
    assert not list(tmp_path.iterdir())
    with pytest.raises(NothingToWrite, match="no flight parameter for coulomb-friction:elbow"):
        new_params(nominal_params(), (CoulombFriction(Joint.ELBOW, 5.0),))
