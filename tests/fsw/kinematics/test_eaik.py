"""The rigid arm of the drawing against EAIK, which finds the same roots by another method.

`pip install --no-deps 'eaik>=1.2'` installs it; without it these tests are skipped.
"""

import numpy as np
import pytest

pytest.importorskip("eaik.pybindings.EAIK", reason="EAIK is not installed; pip install --no-deps 'eaik>=1.2'")

from tests.tools import TOOLS, tool_index
from validation.kinematics_trials import Trial, arm_of
from validation.oracle import KINDS, Eaik, compare, distinct_poses, interface_poses, random_targets

EACH = 200
"""Targets of each kind and tool, 2,000 in all; the benchmark compares 100,000."""
ARM = arm_of("nominal")
AS_EXACT_RAD = 1e-9


@pytest.fixture(scope="module")
def eaik() -> Eaik:
    return Eaik()


def test_eaik_knows_the_arm_by_its_three_parallel_pitch_joints(eaik):
    assert eaik.family == "5R-SECOND_THIRD_FOURTH_PARALLEL"


def test_eaik_and_the_chain_agree_where_the_turret_interface_is(eaik):
    q = np.random.default_rng(1).uniform(-3, 3, (5, 100))
    ours = interface_poses(Trial("nominal", ARM, "drill", None), q)
    theirs = np.stack([eaik.robot.fwdKin(q[:, k]) for k in range(100)])
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-14)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("tool", TOOLS)
def test_eaik_finds_the_roots_that_we_find_and_no_other(eaik, tool, kind):
    rng = np.random.default_rng([7, tool_index(tool), KINDS.index(kind)])
    seen = compare(eaik, tool, *random_targets(tool, kind, rng, EACH))
    assert seen.ours > 6 * EACH
    assert seen.only_ours == seen.only_theirs == 0, seen.examples
    assert seen.widest_rad < AS_EXACT_RAD


def test_roots_that_differ_in_the_elbow_alone_share_their_full_pose():
    """One query gives two roots; every azimuth and wrist needs its own spin about the approach."""
    trial = Trial("nominal", ARM, "apxs", None)
    q = np.array([[0.1, -0.4, 1.2, 1.0, 1.0]]).T
    turned = q + np.array([[0.0], [0.0], [0.0], [0.0], [0.3]])
    poses = interface_poses(trial, np.concatenate([q, turned, q + 2 * np.pi], axis=1))
    assert distinct_poses(poses) == [0, 1]
