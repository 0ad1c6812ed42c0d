"""Collision checks of paths: spacing of samples, deflection of the arm at them, and refusals."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fsw.dictionary.enums import Joint
from fsw.kinematics.chain import forward
from fsw.kinematics.statics import settle
from fsw.motion.paths import (
    COARSE_STEP_M,
    DEFLECTION_CHANGE_M,
    FINE_STEP_M,
    check_paths,
    compute_deflected_frames,
    joint_path,
    sample_paths,
)
from fsw.motion.plan import Compensation, Plan, plan_poses
from tests.fsw.rig import MARS_R_m_s2, Rig, beside_the_rover, find_violation, in_limits

CONFIG = beside_the_rover()
GEOMETRY = CONFIG.collision_geometry
PARAMS = CONFIG.params
PADDING_M = PARAMS.collision.padding_m
READY = np.array(PARAMS.poses.ready_rad)
JOINTS = Rig(CONFIG).state.joints

poses = st.integers(0, 2**32 - 1).map(lambda seed: in_limits(CONFIG, np.random.default_rng(seed), 2).T)


def points_of_arm(frames):
    """Return tool tips, far corners of the turret, elbow and wrist in RMECH, (3, k, n)."""
    tips = np.array([X.p for X in CONFIG.arm.X_FT.values()])
    corners = np.array([[0.3, 0.3, -0.15], [-0.3, 0.3, -0.15], [0.0, -0.35, -0.15], [0.25, -0.25, 0.0]])
    p_F = np.concatenate([tips, corners]).T
    on_turret = np.einsum("ijn,jk->ikn", frames.X_RF.R[:, :, 5], p_F) + frames.X_RF.p[:, 5][:, None]
    return np.concatenate([on_turret, frames.X_RF.p[:, 1:5]], axis=1)


@settings(max_examples=10)
@given(poses)
def test_no_point_of_the_arm_moves_farther_than_a_step_between_two_samples_of_a_joint_move(pair):
    path = joint_path(CONFIG, *pair)
    for step_m in (FINE_STEP_M, COARSE_STEP_M):
        motor = sample_paths(CONFIG, (path,), step_m)
        np.testing.assert_allclose(motor[:, [0, -1]], pair.T, atol=1e-9)
        steps_m = np.diff(points_of_arm(forward(CONFIG.arm, motor)), axis=2)
        assert np.linalg.norm(steps_m, axis=0).max() <= step_m


@settings(max_examples=5)
@given(poses)
def test_what_happens_between_two_samples_of_the_first_look_is_within_half_a_step_and_the_sway(pair):
    """With deflection and backlash, every pose of a path is that close to one that is checked."""
    path = joint_path(CONFIG, *pair)
    coarse, fine = (
        points_of_arm(compute_deflected_frames(CONFIG, JOINTS, sample_paths(CONFIG, (path,), step_m)))
        for step_m in (COARSE_STEP_M, FINE_STEP_M)
    )
    for pose in np.moveaxis(fine[:, :, ::5], -1, 0):
        away = np.linalg.norm(coarse - pose[:, :, None], axis=0).max(axis=0).min()
        assert away <= 0.5 * COARSE_STEP_M + DEFLECTION_CHANGE_M


def test_the_arm_hangs_as_it_settles_with_every_gap_on_the_side_of_its_load():
    motor = in_limits(CONFIG, np.random.default_rng(51), 100)
    loads = settle(CONFIG.arm, motor, np.zeros((5, 1)), MARS_R_m_s2).torque_Nm
    decided = np.abs(loads) > CONFIG.output_friction_Nm[:, None] + 1.0
    gap = np.where(decided, np.sign(loads), 0.0) * CONFIG.half_backlash_rad[:, None]
    judge = points_of_arm(settle(CONFIG.arm, motor, gap, MARS_R_m_s2).frames)
    found = points_of_arm(compute_deflected_frames(CONFIG, JOINTS, motor))
    clear_cut = (decided | (np.abs(loads) < CONFIG.output_friction_Nm[:, None] - 1.0)).all(axis=0)
    assert clear_cut.sum() > 50
    assert np.abs(found - judge)[:, :, clear_cut].max() < 0.5e-3


def way(*poses_rad):
    """Plan paths through these outputs from the first one."""
    start = replace(JOINTS, motor_rad=poses_rad[0] - JOINTS.gear_rad[:, 1])
    plan = plan_poses(CONFIG, start, [np.array(pose) for pose in poses_rad[1:]], Compensation("off"))
    assert isinstance(plan, Plan)
    return plan.paths


@pytest.mark.slow
def test_the_first_look_misses_nothing_that_a_close_look_finds():
    rng = np.random.default_rng(52)
    refused = 0
    for _ in range(40):
        paths = way(*in_limits(CONFIG, rng, 2).T)
        frames = compute_deflected_frames(CONFIG, JOINTS, sample_paths(CONFIG, paths, FINE_STEP_M))
        found = check_paths(CONFIG, JOINTS, paths, PADDING_M)
        close = find_violation(GEOMETRY, frames, PADDING_M)
        assert (found is None) == (close is None)
        refused += found is not None
        if found is not None:
            # a first look that already finds too little distance may name another part than the first of all
            assert re.match("the .* (meets|comes within .* of) the ", found)
            assert found.endswith(" % of the way are clear")
    assert 10 < refused < 40


def test_the_share_of_the_way_that_is_clear_is_the_share_that_could_be_gone():
    down = READY.copy()
    down[Joint.ELEVATION] += 0.7
    found = check_paths(CONFIG, JOINTS, way(READY, down), PADDING_M)
    share = float(found.rsplit("; ", 1)[1].split(" %")[0]) / 100
    for part, clear in ((share - 0.02, True), (share + 0.02, False)):
        there = READY + part * (down - READY)
        assert (check_paths(CONFIG, JOINTS, way(READY, there), PADDING_M) is None) is clear
