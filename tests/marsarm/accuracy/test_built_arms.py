"""Errors of a built arm before any calibration."""

import numpy as np
import pytest
from numpy.random import SeedSequence

from marsarm.accuracy.trial import (
    closed_loop_model,
    configure_believed,
    measure_placements,
    random_placements,
    statics_model,
)
from sim.arms import arm_named
from sim.initialisation import true_reference


def errors_m(name, how, seed, count):
    """Compute the total errors of the APXS at placements in the workspace, shape (count,)."""
    arm = arm_named(name)
    believed = configure_believed(arm)
    moved = (
        statics_model(arm, believed, "on")
        if how == "statics"
        else closed_loop_model(arm, true_reference(arm), "on")
    )
    found = measure_placements(moved, random_placements(believed, "apxs", count, SeedSequence(seed)))
    return np.array([np.linalg.norm(one.error[3:]) for one in found])


@pytest.mark.slow
def test_as_built_arms_are_10_to_20_mm_off():
    """Use 100 arms at two placements each, so that a few good arms cannot decide."""
    errors = np.concatenate([errors_m(f"as-built:{seed}", "statics", seed, 2) for seed in range(100)])
    assert 10e-3 < np.sqrt(np.mean(errors**2)) < 20e-3


def test_the_closed_loop_is_as_far_off_as_statics_say():
    for seed in range(2):
        pair = [errors_m(f"as-built:{seed}", how, seed, 1) for how in ("statics", "closed loop")]
        assert abs(pair[0] - pair[1]) < 0.5e-3
