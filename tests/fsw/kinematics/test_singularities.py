"""Targets next to double roots: each root meets its target and is there once, and each slot has a verdict."""

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from fsw.kinematics.closed_form import branch_index, fold_distances
from fsw.kinematics.ik import inverse_kinematics
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import select_targets
from helpers.marks import slow_but
from tests.fsw.kinematics.lab import (
    assert_consistent,
    assert_no_root_twice,
    assert_roots_meet,
    assert_sentences,
    near_double_roots,
    trial_of,
)
from tests.tools import TOOLS
from validation.kinematics_trials import CLEAR_SIGMA, claimed_roots, smallest_singular_value

N = 110
OVERHEAD_M = 0.02
"""A wrist this close above the elevation joint may have the name of the other elbow."""
RADIAL = [
    ("nominal", "mars", "drill"),
    ("nominal", "mars", "apxs"),
    ("nominal", "tilted", "mahli"),
    ("nominal", "tilted", "portion"),
    ("calibrated:3", "rigid", "drt"),
    ("calibrated:3", "mars", "drill"),
    ("calibrated:3", "tilted", "apxs"),
    ("calibrated:11", "rigid", "apxs"),
    ("calibrated:11", "mars", "drt"),
    ("calibrated:11", "tilted", "mahli"),
]
SKEW = [("skew:1", "mars", "drill"), ("skew:5", "tilted", "drill"), ("skew:8", "mars", "drill")]
SHORT = RADIAL[1], RADIAL[4], SKEW[0]
radial = pytest.mark.parametrize(("name", "gravity", "tool"), slow_but(RADIAL, *SHORT[:2]))
every = pytest.mark.parametrize(("name", "gravity", "tool"), slow_but([*RADIAL, *SKEW], *SHORT))


@every
def test_every_root_meets_its_target_once_and_every_slot_has_its_sentence(name, gravity, tool):
    solved = near_double_roots(name, gravity, tool, N)
    assert_roots_meet(solved, solved.tolerance)
    assert_no_root_twice(solved.result)
    assert_consistent(solved.trial.arm, solved.result)
    for k in range(0, N, 5):
        assert_sentences(solved.trial.arm, select_targets(solved.result, k))


@radial
def test_torques_at_single_roots_are_those_of_the_arm_at_rest(name, gravity, tool):
    solved = near_double_roots(name, gravity, tool, N)
    there, pull = claimed_roots(solved.result), solved.trial.gravity_R_m_s2
    if pull is None:
        assert not solved.result.torque_Nm.any()
    else:
        q, torque_Nm = solved.result.output_rad[:, there], solved.result.torque_Nm[:, there]
        single = smallest_singular_value(solved.trial, q) > CLEAR_SIGMA
        at_rest = settle_output(solved.trial.arm, q[:, single], pull)
        np.testing.assert_allclose(torque_Nm[:, single], at_rest.torque_Nm, rtol=0, atol=1e-4)


@radial
def test_a_root_clear_of_the_folds_is_in_a_slot_of_its_own_branch(name, gravity, tool):
    solved = near_double_roots(name, gravity, tool, N)
    shape, q = solved.trial.arm.orthogonal[tool], solved.result.output_rad
    upper = q[Joint.ELEVATION] + shape.theta_rad[Joint.ELEVATION]
    fore = upper + q[Joint.ELBOW] + shape.theta_rad[Joint.ELBOW]
    ahead_m = np.abs(shape.upper_m * np.cos(upper) + shape.fore_m * np.cos(fore))
    signs = fold_distances(shape, q)
    clear = claimed_roots(solved.result) & (np.abs(signs).min(axis=0) > 0.1) & (ahead_m > OVERHEAD_M)
    assert clear.sum() > 50
    slot = np.broadcast_to(np.arange(q.shape[1])[:, None], clear.shape)
    np.testing.assert_array_equal(branch_index(signs)[clear], slot[clear])


ONCE_TWICE = [
    ("nominal", "mars", (2.3979, -0.0308, 0.5683), (0.5414, 0.0800, 0.8370)),
    ("calibrated:2", "rigid", (2.2891, 0.2840, 0.7820), (0.7657, 0.0523, 0.6410)),
]


@pytest.mark.parametrize(("name", "gravity", "p", "a"), ONCE_TWICE)
@pytest.mark.parametrize("tool", TOOLS)
def test_targets_that_once_had_the_same_root_in_two_slots_have_different_ones(name, gravity, p, a, tool):
    trial, approach = trial_of(name, gravity, tool), np.array(a) / np.linalg.norm(a)
    result = inverse_kinematics(
        trial.arm, tool, np.array(p)[:, None], approach[:, None], trial.gravity_R_m_s2
    )
    assert claimed_roots(result).sum() >= 2
    assert_no_root_twice(result)
    assert_consistent(trial.arm, result)
