"""Errors of a built arm before any calibration."""

import numpy as np
import pytest
from numpy.random import SeedSequence

from marsarm.accuracy.trial import (
    configure_believed,
    measure_placements,
    random_placements,
    statics_model,
)
from sim.arms import arm_named


def errors_m(seed, count):
    """Compute the total errors of the APXS of an arm at placements in the workspace, shape (count,)."""
    arm = arm_named(f"as-built:{seed}")
    believed = configure_believed(arm)
    places = random_placements(believed, "apxs", count, SeedSequence(seed))
    found = measure_placements(statics_model(arm, believed, "on"), places)
    return np.array([np.linalg.norm(one.error[3:]) for one in found])


@pytest.mark.slow
def test_as_built_arms_are_10_to_20_mm_off():
    """Use 100 arms at two placements each, so that a few good arms cannot decide."""
    errors = np.concatenate([errors_m(seed, 2) for seed in range(100)])
    assert 10e-3 < np.sqrt(np.mean(errors**2)) < 20e-3
