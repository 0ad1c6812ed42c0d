"""Names of branches, and the branch of a pose by forward kinematics."""

from itertools import product

import numpy as np
import pytest

from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.closed_form import BRANCHES, branch_index, fold_distances
from tests.fsw.rig import config_of, in_limits
from tests.tools import TOOLS

N = 3000
ARM = config_of().arm
# distance from the turret axis to each tool point, from the drawing
RADIUS_M = {"drill": 0.360, "drt": 0.299, "mahli": 0.2973, "apxs": 0.2983, "portion": 0.2761}


def poses(n=N):
    return in_limits(config_of(), np.random.default_rng(11), n)


def named(words, index):
    """Find the branches with this word in their names."""
    return np.array([words in name for name in BRANCHES])[index]


def test_there_are_eight_branches_with_names_of_their_own():
    words = product(("shoulder-out", "shoulder-in"), ("elbow-up", "elbow-down"), ("wrist-up", "wrist-down"))
    assert sorted(BRANCHES) == sorted(" ".join(three) for three in words)


@pytest.mark.parametrize("tool", TOOLS)
def test_out_looks_toward_the_foot_of_the_turret_axis_and_wrists_carry_it_on_either_side(tool):
    q = poses()
    frames = forward(ARM, q)
    X = tool_pose(ARM, frames, tool)
    foot = X.p - RADIUS_M[tool] * X.R[:, 0]
    ahead_m = np.sum(frames.X_RF.R[:, 0, 1] * (foot - frames.X_RF.p[:, 0]), axis=0)
    n, z5 = frames.X_RF.R[:, 2, 1], frames.X_RF.R[:, 2, 4]
    sine = np.sum(np.cross(n, X.R[:, 0], axis=0) * z5, axis=0)
    signs = fold_distances(ARM.orthogonal[tool], q)
    np.testing.assert_allclose(signs[[0, 2]], [-ahead_m, sine], atol=1e-12)
    np.testing.assert_array_equal(named("shoulder-out", branch_index(signs)), ahead_m > 0)
    np.testing.assert_array_equal(named("wrist-up", branch_index(signs)), sine < 0)


def test_up_is_the_elbow_above_the_line_from_shoulder_to_wrist():
    q = poses()
    frames = forward(ARM, q)
    shoulder, elbow, wrist = (frames.X_RF.p[:, k] for k in (1, 2, 3))
    # z is down
    chord = wrist - shoulder
    share = np.sum((elbow - shoulder) * chord, axis=0) / np.sum(chord * chord, axis=0)
    above_m = (shoulder + share * chord - elbow)[2]
    signs = fold_distances(ARM.orthogonal["apxs"], q)
    clear = np.abs(above_m) > 1e-9
    up = named("elbow-up", branch_index(signs))
    np.testing.assert_array_equal(up[clear], (above_m > 0)[clear])
    np.testing.assert_allclose(np.abs(signs[1]), np.abs(np.sin(q[2])), atol=1e-12)
    assert 0.2 < up.mean() < 0.8
