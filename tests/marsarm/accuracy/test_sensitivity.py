"""Sensitivities agree with the motion of an arm that has the error at a frame, spring or temperature."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.config import configure
from fsw.kinematics.arm import Arm, heat_arm
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, rotate_back
from marsarm.accuracy import propagation
from sim.arms import nominal_params

CONFIG = configure(nominal_params())
ARM = CONFIG.arm
MARS = np.array([0.0, 0.0, 3.711])
SMALL = 1e-4
MODEL = propagation.load_error_model()


@pytest.fixture(scope="module")
def poses() -> propagation.Poses:
    return propagation.workspace_poses(ARM, "mahli", MARS, 60, 3)


@pytest.fixture(scope="module")
def sensitivity(poses: propagation.Poses) -> propagation.Sensitivity:
    return propagation.compute_sensitivity(CONFIG, poses, MARS)


def shift(before: Arm, after: Arm, poses: propagation.Poses, output_rad: Array) -> Array:
    """Compute the shift of the tool in tool axes, shape (3, n).

    The motors stand where they put `before` at the poses.
    """
    here = tool_pose(before, settle_output(before, poses.output_rad, MARS).frames, poses.tool)
    there = tool_pose(after, settle_output(after, output_rad, MARS).frames, poses.tool)
    return rotate_back(here.R, there.p - here.p)


def test_poses_are_as_many_as_asked_for_and_put_the_tool_on_its_target(poses):
    assert poses.output_rad.shape == (5, 60)
    p_R = tool_pose(ARM, settle_output(ARM, poses.output_rad, MARS).frames, poses.tool).p
    assert np.allclose(p_R - poses.p_NoTo_N_m, (p_R - poses.p_NoTo_N_m)[:, :1], atol=1e-6)


def test_a_softer_arm_sags_by_its_share_more(poses, sensitivity):
    softer = replace(
        ARM,
        compliance=ARM.compliance * (1 + SMALL),
        gear_stiffness_Nm_rad=ARM.gear_stiffness_Nm_rad / (1 + SMALL),
    )
    torque = settle_output(ARM, poses.output_rad, MARS).torque_Nm
    wound = poses.output_rad + SMALL * torque / ARM.gear_stiffness_Nm_rad[:, None]
    expected = SMALL * sensitivity.deflection.sum(axis=1)[3:]
    # the load changes with the deflection, which the paper's equation 9 neglects
    assert np.abs(shift(ARM, softer, poses, wound) - expected).max() < 0.06 * np.abs(expected).max()


def test_a_warmer_arm_grows(poses, sensitivity):
    rigid = np.zeros((6, 6, 60))
    before = tool_pose(ARM, forward(ARM, poses.output_rad, rigid), poses.tool)
    warm = heat_arm(ARM, 1.0)
    after = tool_pose(warm, forward(warm, poses.output_rad, rigid), poses.tool)
    grown = sensitivity.expansion_1_K.sum(axis=1)[3:]
    # the deflected arm differs from the rigid one by a few milliradians
    assert np.allclose(rotate_back(before.R, after.p - before.p), grown, atol=2e-2 * np.abs(grown).max())


def test_absolute_components_bound_every_draw(sensitivity):
    rng = np.random.default_rng(0)
    source = MODEL.source["assembly"]
    bound = sensitivity.errors_by_frame(source).sum(axis=1)
    u = sensitivity.errors(source)
    for _ in range(50):
        draw = np.einsum("ikn,k->in", u, rng.uniform(-1.0, 1.0, u.shape[1]))
        assert np.all(np.abs(draw) <= bound)
