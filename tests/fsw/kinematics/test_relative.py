"""Relative compensation: at the reference pose nothing is corrected, elsewhere the difference is."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.ik import BranchVerdict, inverse_kinematics
from fsw.kinematics.roots import refine_roots
from fsw.kinematics.statics import relative_target
from tests.fsw.kinematics.test_roots import deflected_tool
from tests.fsw.rig import MARS_R_m_s2, config_of
from tests.tools import TOOLS

REFERENCE = np.array([0.3, -1.0, 1.6, 2.1, 1.2])


@pytest.mark.parametrize("name", ["nominal", "calibrated:3"])
@pytest.mark.parametrize("tool", TOOLS)
def test_relative_to_the_reference_pose_the_target_there_is_the_reference_pose(name, tool):
    """With the rigid tool at the reference pose as target, the root is the reference pose itself."""
    config = config_of(name)
    drawn = tool_pose(config.arm, forward(config.arm, REFERENCE), tool)
    p, a = relative_target(config.arm, tool, REFERENCE, MARS_R_m_s2, drawn.p, drawn.R[:, 0])
    deflected = deflected_tool(config, REFERENCE, MARS_R_m_s2, tool)
    np.testing.assert_allclose(p, deflected.p, atol=1e-14)
    np.testing.assert_allclose(a, deflected.R[:, 0], atol=1e-14)
    found = refine_roots(config.arm, tool, p, a, MARS_R_m_s2, REFERENCE + 0.01)
    assert found.converged
    np.testing.assert_allclose(found.output_rad, REFERENCE, atol=1e-8)


def test_over_one_spot_the_shifts_of_two_tools_relative_to_each_other_cancel():
    """The shift of one tool, relative to the other, is the opposite of the other's; stiff springs."""
    config = config_of()
    arm = replace(config.arm, compliance=1e-3 * config.arm.compliance)
    spot = tool_pose(arm, forward(arm, REFERENCE), "apxs")
    p, a = spot.p, spot.R[:, 0]
    result = inverse_kinematics(arm, "drt", p, a)
    there = result.output_rad[:, np.flatnonzero(result.verdict == BranchVerdict.VALID)[-1]]
    shifts = []
    for tool, pose, other, other_pose in (
        ("drt", there, "apxs", REFERENCE),
        ("apxs", REFERENCE, "drt", there),
    ):
        target = relative_target(arm, other, other_pose, MARS_R_m_s2, p, a)
        found = refine_roots(arm, tool, *target, MARS_R_m_s2, pose)
        assert found.converged
        shifts.append(tool_pose(arm, forward(arm, found.output_rad), tool).p - p)
    assert np.linalg.norm(shifts[0]) > 2e-7
    np.testing.assert_allclose(shifts[0], -shifts[1], atol=2e-3 * np.linalg.norm(shifts[0]))
