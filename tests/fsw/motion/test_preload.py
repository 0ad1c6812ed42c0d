"""Preloads: the tool stays in place while the overdrive rises, and while it is released."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.commands import ClearFault, Preload, Retract, Stop
from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import CommandAborted, CommandCompleted, Preloaded, PreloadMissed
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.statics import settle_output
from fsw.motion.force_fit import MIN_CORRECTION_N
from fsw.motion.preload import PRIOR_RATIO_STD, anchor_contact, locate_by_resolvers, model_contact
from tests.fsw.executive.lab import TOUCHED, guarded_in_contact
from tests.fsw.rig import Rig, made_once

STAYS_M = 2e-5
"""Tolerance: encoder counts and bounds of the backlash move the tool by some micrometres."""


def tool_under_force(rig: Rig):
    """Compute the tool pose of the modelled arm under the reaction of the surface."""
    state, arm = rig.state, rig.config.arm
    push = None if state.preload is None else state.preload.reaction
    here = settle_output(arm, state.joints.output_rad, state.joints.imu_R_m_s2, push)
    return tool_pose(arm, here.frames, "apxs")


@made_once
def pressed_with(force_N: float) -> Rig:
    rig = guarded_in_contact()
    rig.run(Preload("apxs", force_N), **TOUCHED)
    return rig


def test_the_force_rises_and_the_tool_ends_where_it_touched():
    rig = guarded_in_contact()
    forces = []
    rig.cycle(Preload("apxs", 300.0), **TOUCHED)
    while rig.outputs.joint.busy:
        rig.cycle(**TOUCHED)
        forces.append(rig.state.preload.force_N)
    assert np.all(np.diff(forces) > -1e-9)
    touched, ends = rig.state.preload, tool_under_force(rig)
    assert np.linalg.norm(ends.p - touched.p_RoTo_R_m) < STAYS_M
    assert np.abs(ends.R[:, 0] - touched.axis_R).max() < STAYS_M
    assert touched.force_N == pytest.approx(300.0, abs=MIN_CORRECTION_N)
    assert Preloaded("apxs", touched.force_N) in rig.evrs
    assert rig.state.mode is Mode.PRELOAD


def test_a_press_that_no_current_shows_is_reported_also_when_it_is_lowered_but_not_when_it_is_released():
    rig = pressed_with(300.0)
    rig.run(Preload("apxs", 150.0), **TOUCHED)
    rig.run(Preload("apxs", 0.0), **TOUCHED)
    missed = [evr for evr in rig.evrs if isinstance(evr, PreloadMissed)]
    assert [evr.commanded_N for evr in missed] == [300.0, 150.0]
    assert [evr.reason for evr in missed] == [
        f"motor currents show the force to {PRIOR_RATIO_STD * force_N:.0f} N only"
        for force_N in (298.4, 150.0)
    ]


def test_a_press_begins_where_the_tool_has_slid_to():
    rig = guarded_in_contact()
    touch = model_contact(rig.config, rig.state.joints, "apxs")
    aside = np.array([0.001, 0.0, 0.0])
    moved = replace(touch, p_RoTo_R_m=touch.p_RoTo_R_m + aside)
    anchored = anchor_contact(rig.config, rig.state.joints, moved)
    assert np.linalg.norm(anchored.p_RoTo_R_m - touch.p_RoTo_R_m) < STAYS_M
    assert anchored.force_N == touch.force_N


@pytest.mark.parametrize(("error_rad", "believed_rad"), [(2e-4, 2e-4), (-2e-4, -2e-4), (5e-3, 3e-4)])
def test_resolvers_are_believed_as_far_as_the_gear_angles_are_uncertain(error_rad, believed_rad):
    rig = guarded_in_contact()
    touch = model_contact(rig.config, rig.state.joints, "apxs")
    likely = rig.state.joints.gear_rad[:, 1]
    gear = np.column_stack((likely - 3e-4, likely, likely + 3e-4))
    off = touch.resolver_offset_rad + error_rad
    joints = replace(rig.state.joints, gear_rad=gear, resolver_error_rad=off)
    located = locate_by_resolvers(joints, touch)
    np.testing.assert_allclose(located.output_rad - joints.output_rad, believed_rad, atol=1e-12)


def test_a_force_is_changed_and_released_the_way_it_came():
    rig = pressed_with(200.0)
    rig.run(Preload("apxs", 80.0), **TOUCHED)
    assert (rig.state.mode, rig.state.preload.force_N) == (Mode.PRELOAD, 80.0)
    assert CommandCompleted("Preload") in rig.run(Preload("apxs", 0.0), **TOUCHED)
    assert (rig.state.mode, rig.state.preload.force_N) == (Mode.GUARDED, 0.0)
    rig.cycle(Retract("apxs", 0.02), **TOUCHED)
    assert (rig.state.mode, rig.state.preload) == (Mode.RETRACTING, None)


def test_every_joint_carries_the_force_times_its_lever():
    rig = pressed_with(300.0)
    press = rig.state.preload
    axis, p = press.axis_R, press.p_RoTo_R_m
    here = settle_output(rig.config.arm, rig.state.joints.output_rad, rig.state.joints.imu_R_m_s2).frames
    z, origin = here.X_RL.R[:, 2, 1:], here.X_RL.p[:, 1:]
    levers = np.einsum("ij,ij->j", z, np.cross((p[:, None] - origin).T, -axis).T)
    pushed = settle_output(
        rig.config.arm, rig.state.joints.output_rad, rig.state.joints.imu_R_m_s2, press.reaction
    ).torque_Nm
    free = settle_output(rig.config.arm, rig.state.joints.output_rad, rig.state.joints.imu_R_m_s2).torque_Nm
    np.testing.assert_allclose(pushed - free, 300.0 * levers, atol=0.06 * np.abs(300.0 * levers).max())


def test_current_limits_stop_a_press_well_before_the_joints_of_a_move():
    rig = guarded_in_contact()
    rig.state = replace_friction(rig, 170.0)
    rig.cycle(Preload("apxs", 100.0), **TOUCHED)
    rig.cycle(**TOUCHED)
    limit = rig.outputs.drive.current_limit_A
    assert np.all(limit <= rig.config.current_limit_A)
    assert limit[:3].max() < 0.5 * rig.config.current_limit_A[0]


def replace_friction(rig: Rig, friction_Nm: float):
    joints = rig.state.joints
    reference = replace(joints.reference, friction_Nm=np.full(5, friction_Nm))
    return replace(rig.state, joints=replace(joints, reference=reference))


def test_nothing_is_pressed_without_a_closed_switch_nor_with_another_tool_nor_with_too_much_force():
    rig = guarded_in_contact()
    rig.evrs.clear()
    rig.cycle(Preload("apxs", 100.0))
    rig.cycle(Preload("drill", 100.0), Preload("apxs", 351.0), **TOUCHED)
    *reasons, too_much = [evr.reason for evr in rig.evrs]
    assert reasons == [
        "apxs touches nothing: there is nothing to press on",
        "apxs is the tool that may touch; retract it first",
    ]
    assert "force" in too_much


@pytest.mark.parametrize("end", ["stop", "fault"])
def test_a_press_that_ends_early_is_remembered_and_can_be_released(end):
    rig = guarded_in_contact()
    rig.cycle(Preload("apxs", 200.0), **TOUCHED)
    while rig.state.preload.force_N < 100.0:
        rig.cycle(**TOUCHED)
    if end == "stop":
        evrs = rig.run(Stop(), **TOUCHED)
        assert CommandAborted("Preload") in evrs
    else:
        rig.cycle(current_A=[float("nan")] * 5, **TOUCHED)
        rig.run(**TOUCHED)
        assert rig.state.mode is Mode.FAULTED
        rig.cycle(ClearFault(), **TOUCHED)
    assert rig.state.mode is Mode.PRELOAD
    assert 95.0 < rig.state.preload.force_N < 120.0
    rig.run(Preload("apxs", 0.0), **TOUCHED)
    assert (rig.state.mode, rig.state.preload.force_N) == (Mode.GUARDED, 0.0)


@pytest.mark.parametrize("left_N", [6.0, 0.0])
def test_a_release_that_is_stopped_near_its_end_can_be_ended_and_the_tool_taken_off(left_N):
    rig = pressed_with(100.0)
    rig.cycle(Preload("apxs", 0.0), **TOUCHED)
    while rig.state.preload.force_N > left_N:
        rig.cycle(**TOUCHED)
    rig.run(Stop(), **TOUCHED)
    assert rig.state.mode is Mode.PRELOAD
    stopped = rig.state.preload.force_N
    assert stopped <= left_N
    evrs = rig.run(Preload("apxs", 0.0), **TOUCHED)
    assert Preloaded("apxs", stopped) in evrs
    assert CommandCompleted("Preload") in evrs
    assert rig.state.mode is Mode.GUARDED
    rig.cycle(Retract("apxs", 0.02), **TOUCHED)
    assert rig.state.mode is Mode.RETRACTING
