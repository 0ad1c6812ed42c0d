"""Presses: the force rises, is corrected by what is felt, and is let go."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.commands import ClearFault, Preload, Retract, Stop
from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import (
    CommandAborted,
    CommandCompleted,
    CommandRefused,
    ForceEstimated,
    Preloaded,
    PreloadMissed,
)
from fsw.kinematics.chain import forward, joint_jacobian, tool_pose
from fsw.kinematics.statics import settle_output
from fsw.motion.force_fit import MIN_CORRECTION_N, MIN_RATIO_STD, ForceFit, estimate_force_ratio, report_miss
from fsw.motion.move import Phase
from fsw.motion.plan import Refusal
from fsw.motion.preload import (
    PRIOR_RATIO_STD,
    anchor_contact,
    locate_by_resolvers,
    model_contact,
    plan_preload,
)
from fsw.motion.work import complete
from helpers.marks import slow_but
from tests.fsw.executive.lab import TOUCHED, guarded_in_contact
from tests.fsw.rig import Rig, in_the_open, made_once

STAYS_M = 2e-5
"""Tolerance: encoder counts and bounds of the backlash move the tool by some micrometres."""


@made_once
def pressed_with(force_N: float) -> Rig:
    rig = guarded_in_contact()
    rig.run(Preload("apxs", force_N), **TOUCHED)
    return rig


def test_the_force_rises_and_the_tool_ends_where_it_touched():
    rig = guarded_in_contact()
    forces = []
    rig.begin(Preload("apxs", 300.0), **TOUCHED)
    while rig.outputs.joint.busy:
        rig.cycle(**TOUCHED)
        forces.append(rig.state.preload.force_N)
    assert np.all(np.diff(forces) > -1e-9)
    state, arm = rig.state, rig.config.arm
    here = settle_output(arm, state.joints.output_rad, state.joints.imu_R_m_s2, state.preload.reaction)
    touched, ends = state.preload, tool_pose(arm, here.frames, "apxs")
    assert np.linalg.norm(ends.p - touched.p_RoTo_R_m) < STAYS_M
    assert np.abs(ends.R[:, 0] - touched.axis_R).max() < STAYS_M
    assert touched.force_N == pytest.approx(300.0, abs=MIN_CORRECTION_N)
    assert Preloaded("apxs", touched.force_N) in rig.evrs
    assert rig.state.mode is Mode.PRELOAD


@pytest.mark.slow
def test_a_press_that_no_current_shows_is_reported_also_when_it_is_lowered_but_not_when_it_is_released():
    rig = guarded_in_contact()
    for force_N in (300.0, 150.0, 0.0):
        rig.run(Preload("apxs", force_N), **TOUCHED)
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
    rig.begin(Retract("apxs", 0.02), **TOUCHED)
    assert (rig.state.mode, rig.state.preload) == (Mode.RETRACTING, None)


def test_a_press_is_refused_where_no_joint_angles_keep_the_tool():
    rig = guarded_in_contact()
    touch = model_contact(rig.config, rig.state.joints, "apxs")
    no_angles, beyond = (
        "no overdrive found from 2.0 to 300.0 N",
        "at 2.0 N, joint elbow: 189.0 deg is outside",
    )
    for aside_m, reason in ((9.0, no_angles), (-1.0, beyond)):
        moved = replace(touch, p_RoTo_R_m=touch.p_RoTo_R_m + np.array([aside_m, 0.0, 0.0]))
        work = plan_preload(rig.config, rig.state.joints, moved, 300.0)
        assert complete(rig.config, work).reason.startswith(reason)


@pytest.mark.parametrize("softer", [100.0, 1e6])
def test_a_press_is_refused_for_an_arm_too_soft_to_come_to_rest(softer):
    rig = guarded_in_contact()
    touch = model_contact(rig.config, rig.state.joints, "apxs")
    soft = replace(rig.config, arm=replace(rig.config.arm, compliance=softer * rig.config.arm.compliance))
    refusal = complete(soft, plan_preload(soft, rig.state.joints, touch, 300.0))
    assert refusal == Refusal("no overdrive found from 2.0 to 300.0 N")


def test_a_press_with_another_part_in_the_ground_or_by_a_small_change_is_refused():
    rig = guarded_in_contact()
    rig.config, height_m = in_the_open(rig.config), float(rig.tool_pose("apxs").p[2])
    vars(rig.config)["collision_geometry"] = replace(rig.config.collision_geometry, ground_z_m=height_m)
    events = [rig.begin(Preload("apxs", force_N), **TOUCHED) for force_N in (300.0, 5.0)]
    reasons = ["the DRT meets the ground; 0 % of the way are clear", "apxs is pressed with 2.0 N as it is"]
    refused = [evr.reason for some in events for evr in some if isinstance(evr, CommandRefused)]
    assert refused == reasons


def test_current_limits_stop_a_press_well_before_the_joints_of_a_move():
    rig = guarded_in_contact()
    joints = rig.state.joints
    reference = replace(joints.reference, friction_Nm=np.full(5, 170.0))
    rig.state = replace(rig.state, joints=replace(joints, reference=reference))
    rig.begin(Preload("apxs", 100.0), **TOUCHED)
    rig.cycle(**TOUCHED)
    limit = rig.outputs.drive.current_limit_A
    assert np.all(limit <= rig.config.current_limit_A)
    assert limit[:3].max() < 0.5 * rig.config.current_limit_A[0]


def test_nothing_is_pressed_without_a_closed_switch_nor_with_another_tool_nor_with_too_much_force():
    rig = guarded_in_contact()
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
    rig.begin(Preload("apxs", 200.0), **TOUCHED)
    while rig.state.preload.force_N < 100.0:
        rig.cycle(**TOUCHED)
    if end == "stop":
        evrs = rig.run(Stop(), **TOUCHED)
        assert CommandAborted("Preload") in evrs
    else:
        rig.go_blind(**TOUCHED)
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
    rig.begin(Preload("apxs", 0.0), **TOUCHED)
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
    rig.begin(Retract("apxs", 0.02), **TOUCHED)
    assert rig.state.mode is Mode.RETRACTING


FRICTION_NM = np.array([170.0, 170.0, 170.0, 39.0, 39.0])


def pressed(
    stiffness: float, friction: float = 1.0, offset_Nm: float = 0.0, across=(0.0, 0.0), force_N: float = 200.0
):
    """Return a rig after a preload, with the motor currents of an arm of another stiffness.

    Args:
        stiffness: True stiffness over modelled stiffness.
        friction: True friction over the friction measured at the hardstops.
        offset_Nm: Error of every current, as a torque.
        across: Forces along the tool's y and z axes per newton of the model.
        force_N: Commanded force.
    """
    rig = guarded_in_contact()
    joints = rig.state.joints
    reference = replace(joints.reference, friction_Nm=FRICTION_NM)
    rig.state = replace(rig.state, joints=replace(joints, reference=reference))
    press(rig, force_N, stiffness, friction, offset_Nm, across)
    return rig


def press(rig, force_N: float, stiffness: float, friction=1.0, offset_Nm=0.0, across=(0.0, 0.0)) -> None:
    rig.begin(Preload("apxs", force_N), **TOUCHED)
    while rig.outputs.joint.busy:
        rig.cycle(current_A=currents(rig, stiffness, friction, offset_Nm, across), **TOUCHED)


def force_events(rig, least: int = 1) -> list[ForceEstimated]:
    """Return the events with the estimated force, one for each leg."""
    found = [evr for evr in rig.evrs if isinstance(evr, ForceEstimated)]
    assert len(found) >= least
    return found


def preloads(rig) -> list[float]:
    return [evr.force_N for evr in rig.evrs if isinstance(evr, Preloaded)]


def currents(rig, stiffness: float, friction: float, offset_Nm: float, across) -> np.ndarray:
    state, config = rig.state, rig.config
    move = state.move
    if move.phase is not Phase.RUN:
        return np.full(5, 1e-9 * state.tick)
    of_model = move.plan.preload_change.torque_per_N * state.preload.model_N
    arm, frames = config.arm, forward(config.arm, state.joints.output_rad)
    X_RT = tool_pose(arm, frames, state.preload.tool)
    across_per_N = joint_jacobian(frames, X_RT.p)[3:].T @ X_RT.R[:, 1:]  # along the tool's y and z axes
    per_N = (stiffness - 1.0) * move.plan.preload_change.torque_per_N + across_per_N @ np.array(across)
    # the estimated load contains the estimated reaction already
    extra = per_N * state.preload.model_N + (1 - state.preload.force_ratio) * of_model
    resisting = friction * FRICTION_NM * np.sign(move.setpoint.rate_rad_s)
    torque = resisting - state.load.torque_Nm - extra + offset_Nm
    return torque / config.torque_constant_Nm_A + 1e-9 * state.tick


@pytest.mark.parametrize("stiffness", slow_but([0.8, 0.9, 1.15], 0.8))
@pytest.mark.parametrize(("friction", "offset_Nm"), slow_but([(1.0, 0.0), (1.05, 5.0)], (1.05, 5.0)))
def test_the_share_of_the_force_is_felt_and_made_up_for(stiffness, friction, offset_Nm):
    rig = pressed(stiffness, friction, offset_Nm)
    for event in force_events(rig):
        assert event.along == pytest.approx(stiffness, abs=0.03)
    assert rig.state.preload.model_N * stiffness == pytest.approx(200.0, rel=0.04)
    assert preloads(rig) == [pytest.approx(200.0, abs=MIN_CORRECTION_N)]


@pytest.mark.parametrize("stiffness", slow_but([0.8, 1.15], 1.15))
def test_what_was_felt_is_remembered_by_the_presses_that_follow(stiffness):
    rig = pressed(stiffness, force_N=100.0)
    for force_N in (200.0, 150.0):
        press(rig, force_N, stiffness)
        assert rig.state.preload.model_N * stiffness == pytest.approx(force_N, rel=0.04)
    assert preloads(rig) == [
        pytest.approx(force_N, abs=MIN_CORRECTION_N) for force_N in (100.0, 200.0, 150.0)
    ]


@pytest.mark.parametrize("across", [(0.15, 0.0), pytest.param((0.0, -0.2), marks=pytest.mark.slow)])
def test_a_force_across_is_told_from_the_one_along(across):
    rig = pressed(0.85, across=across)
    for event in force_events(rig):
        assert event.along == pytest.approx(0.85, abs=0.03)
        assert event.across == pytest.approx(np.hypot(*across), abs=0.05)


def fit_of(force_N, turns_from_N=(0.0,) * 5):
    """Estimate the ratio of a press to 300 N of the model, in which the arm applies `force_N(model_N)`.

    Args:
        force_N: True force by that of the model.
        turns_from_N: Force of the model from which each motor turns.
    """
    rig = guarded_in_contact()
    config, joints = rig.config, rig.state.joints
    preload = model_contact(config, joints, "apxs")
    per_N = complete(config, plan_preload(config, joints, preload, 300.0)).change.torque_per_N
    fit, turns, turns_from_N = ForceFit(preload), np.ones(5), np.array(turns_from_N)
    for model_N in np.linspace(20.0, 300.0, 1000):
        fit = fit.add_cycle(model_N, 10.0, per_N * force_N(model_N), turns, turns_from_N <= model_N)
    return estimate_force_ratio(config, fit, joints, preload)


@pytest.mark.parametrize(("share", "is_plausible"), [(0.2, False), (0.8, True), (3.0, False)])
def test_what_cannot_be_is_not_believed(share, is_plausible):
    assert (fit_of(lambda model_N: share * model_N) is not None) == is_plausible


def test_a_force_that_stands_still_while_a_backlash_is_crossed_is_not_counted():
    ratio = fit_of(lambda model_N: min(model_N, 150.0) + max(model_N - 200.0, 0.0))
    assert ratio.along == pytest.approx((300.0 - 50.0 - 20.0) / (300.0 - 20.0), abs=0.03)


def test_motors_that_turn_only_from_a_later_force_count_from_there():
    never, late = (fit_of(lambda model_N: 0.8 * model_N, (n, 0, n, n, n)) for n in (400.0, 60.0))
    assert late.along == pytest.approx(0.8, abs=0.03)
    assert late.std < 0.7 * never.std
    assert fit_of(lambda model_N: 0.8 * model_N, (400.0,) * 5) is None


UNKNOWN = "motor currents show the force to 11 N only"


@pytest.mark.parametrize(
    ("target_N", "std", "reason"),
    [
        *((target_N, MIN_RATIO_STD, None) for target_N in (105.0, 95.0)),
        *((target_N, MIN_RATIO_STD, "out of reach") for target_N in (120.0, 80.0)),
        (100.0, 0.09, None),
        (100.0, 0.11, UNKNOWN),
    ],
)
def test_a_press_that_ends_more_than_a_tenth_off_or_is_not_known_to_a_tenth_says_why(target_N, std, reason):
    rig = guarded_in_contact()
    contact = model_contact(rig.config, rig.state.joints, "apxs")
    preload = replace(contact, model_N=100.0, force_ratio_std=std)
    events = report_miss(target_N, preload, None if target_N == 100.0 else Refusal("out of reach"))
    assert events == (() if reason is None else (PreloadMissed("apxs", 100.0, target_N, reason),))
