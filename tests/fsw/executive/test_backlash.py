"""Undecided backlash before a tool change: the joint, how far at the tool, and the bound of a refusal."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.commands import ToolChange
from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import BacklashUndecided, CommandAccepted, CommandRefused
from fsw.estimate.gear import LIKELY
from fsw.executive.backlash import assess_backlash
from tests.fsw.executive import lab
from tests.fsw.rig import pose_of, with_params

CHANGE = ToolChange("mahli", standoff_m=0.05)


def touching(undecided=()):
    """A rig whose APXS touches, while the flanks of these joints are not known."""
    rig = lab.guarded_in_contact()
    joints = rig.state.joints
    half = joints.reference.half_backlash_rad
    gear, bounds = joints.gear_rad.copy(), joints.bounds
    for joint in Joint:
        gear[joint] = gear[joint, LIKELY]
    for joint in undecided:
        gear[joint] = half[joint] * np.array([-1.0, -1.0, 1.0])
    bounds = replace(
        bounds,
        lowest_rad=np.minimum(bounds.lowest_rad, gear),
        highest_rad=np.maximum(bounds.highest_rad, gear),
    )
    baseline = replace(joints.baseline, located_motor_rad=joints.motor_rad)
    joints = replace(joints, gear_rad=gear, bounds=bounds, baseline=baseline)
    rig.state = replace(rig.state, joints=joints)
    return rig


def moved_across_m(rig, joint, turn_rad):
    """Distance of the APXS across its axis when one output turns."""
    joints = rig.state.joints
    turned = joints.output_rad.copy()
    turned[joint] += turn_rad
    before, after = (
        pose_of(rig.config.arm, output, "apxs", joints.gravity_R_m_s2)
        for output in (joints.output_rad, turned)
    )
    moved, axis = after.p - before.p, before.R[:, 0]
    return np.linalg.norm(moved - (moved @ axis) * axis)


@pytest.mark.parametrize("joint", Joint)
def test_a_tool_change_tells_before_it_moves_which_joint_is_undecided_and_how_far_at_the_tool(joint):
    rig = touching([joint])
    width_rad = 2 * rig.state.joints.reference.half_backlash_rad[joint]
    rig.begin(CHANGE, **lab.TOUCHED)
    (told,) = [evr for evr in rig.evrs if isinstance(evr, BacklashUndecided)]
    assert (told.joint, told.tool) == (joint, "apxs")
    assert told.error_rad == pytest.approx(width_rad)
    assert told.error_m == pytest.approx(moved_across_m(rig, joint, width_rad), rel=0.02)
    assert f"{told.error_m:.4f} m at apxs" in told.message
    assert CommandAccepted("ToolChange") in rig.evrs
    assert not rig.outputs.drive.setpoint_rate_rad_s.any()


def test_a_tool_change_from_decided_sides_tells_nothing():
    rig = touching()
    rig.begin(CHANGE, **lab.TOUCHED)
    assert CommandAccepted("ToolChange") in rig.evrs
    assert not any(isinstance(evr, BacklashUndecided) for evr in rig.evrs)


def test_a_tool_change_from_a_spot_that_is_not_known_well_enough_is_refused():
    rig = touching([Joint.AZIMUTH, Joint.TURRET])
    known_m = assess_backlash(rig.config, rig.state.joints, "apxs").error_m.sum()
    for bound_m, is_refused in ((1.01 * known_m, False), (0.99 * known_m, True)):
        here = rig.fork()
        here.config = with_params(motion={"spot_error_m": float(bound_m)})
        here.begin(CHANGE, **lab.TOUCHED)
        refusals = [evr for evr in here.evrs if isinstance(evr, CommandRefused)]
        assert bool(refusals) is is_refused
    (refused,) = refusals
    assert refused.reason == (
        "the backlash of azimuth, turret is undecided: the spot of apxs is known to "
        f"{1e3 * known_m:.1f} mm, at most {1e3 * bound_m:.1f} mm are allowed; touch it again"
    )
