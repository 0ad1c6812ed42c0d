"""Cross-validation against fits without the block, and temperature against placebo curves."""

from dataclasses import replace

import numpy as np
import pytest

from helpers.serial_synthetic import POSITION_M, built_arm, drawn_arm, series, setup
from simgap.serial_arm.calibrate import calibrate_series, estimate_setup, fit_poses, pose_errors
from simgap.serial_arm.chain import Pose
from simgap.serial_arm.model import TERMS
from simgap.serial_arm.nested_models import BLOCKS, CrossValidation, temperature_test

COUNT = 300


def validated(air, moved_m):
    """Cross-validate an arm with air temperature (n,) and target shifts (3, n)."""
    drawn = drawn_arm(3)
    part = series(built_arm(drawn, 1), setup(2), COUNT, 3, air=air)
    part = replace(part, X_TM=Pose(part.X_TM.R, part.X_TM.p + moved_m))
    found = calibrate_series(drawn, estimate_setup(drawn, part), part, TERMS)
    return found, CrossValidation(found.fit, drawn.repeatability.position_m)


def test_a_block_is_predicted_as_by_a_fit_that_never_saw_it():
    found, validation = validated(None, np.zeros((3, COUNT)))
    held_out = validation.held_out()
    part = found.model.series
    for k in range(BLOCKS):
        mine = held_out.block == k
        others = fit_poses(found.model.arm, found.model.setup, part, TERMS, ~mine)
        error = pose_errors(others.arm, others.setup, part.at(mine))
        assert held_out.rms_by_block_m[k] == pytest.approx(error.rms_m, rel=0.01)


def test_a_temperature_that_moves_the_base_explains_something():
    air = 22 + np.sin(np.linspace(0, 9, COUNT)) + 0.3 * np.sin(np.linspace(0, 70, COUNT))
    moved = np.array([[0.0], [0.0], [3 * POSITION_M]]) * (air - 22)
    test = temperature_test(*validated(air, moved))
    assert test.explains
    assert test.gain_m > 3 * test.gain_sigma_m


def test_a_drift_that_a_step_of_the_temperature_resembles_is_left_to_the_clock():
    time = np.linspace(-1, 1, COUNT)
    air = np.where(time > 0.2, 22.1, 21.7)
    drift = np.array([[0.0], [0.0], [3 * POSITION_M]]) * time
    test = temperature_test(*validated(air, drift))
    assert test.gain_m > test.gain_sigma_m
    assert not test.explains
    assert test.placebo == "clock"


def test_without_a_thermometer_nothing_is_said():
    found, validation = validated(None, np.zeros((3, COUNT)))
    assert temperature_test(found, validation) is None


def test_a_temperature_that_stays_the_same_explains_nothing():
    test = temperature_test(*validated(np.full(COUNT, 21.0), np.zeros((3, COUNT))))
    assert not test.explains
    assert test.range_K == 0.0
