"""Findings as a patch for the simulator and as flight parameters."""

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from marsarm.common.requests import parse_effects
from marsarm.diagnosis.arm.output_files import (
    NothingToWrite,
    effects_of_findings,
    new_params,
    save_new_params,
    save_patch,
)
from marsarm.diagnosis.arm.simulator import list_candidates, to_hypothesis
from sim.arms import nominal_params, params_over_nominal
from sim.effects.gears import CoulombFriction
from sim.effects.joints import GearStiffness
from tests.marsarm.diagnosis.results import as_of
from tests.tools import TOOLS


def _hypothesis(name):
    return next(one for one in map(to_hypothesis, list_candidates(None)) if one.name == name)


@pytest.fixture
def softer(results):
    """Return a diagnosis with a softer gear."""
    return as_of(results["alike"], _hypothesis("gear-stiffness at elbow"), [np.log(0.8)])


def test_a_finding_is_the_effect_of_the_size_that_was_found(softer):
    (effect,) = effects_of_findings(softer)
    assert isinstance(effect, GearStiffness)
    assert effect.joint is Joint.ELBOW
    assert effect.factor == pytest.approx(0.8)


def test_the_patch_is_what_the_option_effect_takes(softer, tmp_path):
    save_patch(softer, tmp_path / "found.toml")
    assert parse_effects((str(tmp_path / "found.toml"),), TOOLS) == effects_of_findings(softer)
    assert "Gear-stiffness at elbow (" in (tmp_path / "found.toml").read_text()


def test_flight_parameters_know_what_was_found(softer, tmp_path):
    save_new_params(softer, nominal_params(), nominal_params(), tmp_path / "new.toml")
    read = params_over_nominal(tmp_path / "new.toml")
    assert read == new_params(nominal_params(), effects_of_findings(softer))
    softened = nominal_params().joints.elbow.gear_stiffness_Nm_rad * 0.8
    assert read.joints.elbow.gear_stiffness_Nm_rad == pytest.approx(softened)


def test_an_effect_without_flight_parameter_gives_no_file(results, tmp_path):
    effect = _hypothesis("coulomb-friction at elbow")
    sizes = [p.typical for p in effect.parameters]
    (found,) = effects_of_findings(as_of(results["named"], effect, sizes))
    assert isinstance(found, CoulombFriction)
    with pytest.raises(NothingToWrite, match="no flight parameter for coulomb-friction:elbow"):
        new_params(nominal_params(), (found,))


@pytest.mark.parametrize("name", ["nothing", "unknown"])
def test_where_no_name_is_given_there_is_no_patch(results, tmp_path, name):
    with pytest.raises(NothingToWrite, match="no effect was found"):
        save_patch(results[name], tmp_path / "found.toml")
    assert not list(tmp_path.iterdir())
