"""Single commands: their arguments, their effect, stops, faults and cleared faults."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.commands import (
    Calibrate,
    CalibrateAll,
    ClearFault,
    GuardedMove,
    MoveJoint,
    MoveJoints,
    MoveTool,
    Preload,
    Retract,
    Stop,
    Stow,
    Unstow,
)
from fsw.dictionary.enums import HARDSTOP_ORDER, Joint, Mode
from fsw.dictionary.evrs import (
    BranchChosen,
    CommandAborted,
    CommandAccepted,
    CommandCompleted,
    CommandRefused,
    FaultCleared,
    FaultResponse,
    ModeChanged,
)
from fsw.dictionary.faults import HardstopMissed
from fsw.kinematics.closed_form import BRANCHES
from fsw.protect.readings import ReadingState
from fsw.state import Hold, Sequence
from helpers.marks import slow_but
from tests.fsw.executive import lab
from tests.fsw.rig import Rig, floats, with_params

NOT_CALIBRATED = "not calibrated: {}; until it is, a joint may only look for its hardstop"


def test_a_tool_move_says_which_branch_it_takes():
    rig = lab.deployed()
    rig.begin(rig.here("apxs", 0.01))
    chosen = [evr for evr in rig.evrs if isinstance(evr, BranchChosen)]
    assert [evr.tool for evr in chosen] == ["apxs"]
    assert chosen[0].branch in BRANCHES


@pytest.mark.slow
def test_unstow_leads_past_the_way_points_to_the_ready_pose_and_stow_leads_back():
    drawn = lab.CONFIG.params.joints.in_order()
    joints = {joint.name.lower(): replace(drawn[joint], speed_rad_s=0.1) for joint in Joint}
    config = with_params(joints=joints)
    poses = config.params.poses
    rig = Rig(config, Mode.STOWED, poses.stowed_rad)
    evrs = rig.run(Unstow())
    assert CommandCompleted("Unstow") in evrs
    # friction holds a joint that is there already within this bound
    held_rad = 2 * config.output_friction_Nm / config.arm.gear_stiffness_Nm_rad + 1e-5
    assert (np.abs(rig.state.joints.output_rad - poses.ready_rad) < held_rad).all()
    modes = [(evr.before, evr.after) for evr in evrs if isinstance(evr, ModeChanged)]
    assert modes == [
        (Mode.STOWED, Mode.PLANNING),
        (Mode.PLANNING, Mode.FREE_SPACE),
        (Mode.FREE_SPACE, Mode.DEPLOYED),
    ]
    assert CommandCompleted("Stow") in rig.run(Stow())
    assert rig.state.mode is Mode.STOWED
    np.testing.assert_allclose(rig.state.joints.output_rad, poses.stowed_rad, atol=1e-4)


@pytest.mark.parametrize("joint", Joint)
def test_one_joint_moves_to_its_angle_and_the_others_stay_where_they_are(joint):
    rig = lab.deployed()
    start, goal = rig.count.copy(), float(lab.START[joint]) + 0.01
    assert CommandCompleted("MoveJoint") in rig.run(MoveJoint(joint, goal))
    assert rig.state.joints.output_rad[joint] == pytest.approx(goal, abs=1e-5)
    np.testing.assert_array_equal(np.flatnonzero(rig.count != start), [joint])


@pytest.mark.parametrize("joint", Joint)
def test_a_joint_is_not_calibrated_from_when_it_begins_to_look_for_its_hardstop_until_it_found_it(joint):
    rig, others = lab.deployed(), np.arange(5) != joint
    rig.until_moving(Calibrate(joint))
    np.testing.assert_array_equal(rig.outputs.joint.calibrated, others)
    drive = rig.outputs.drive
    np.testing.assert_array_equal(drive.power_on, ~others)
    np.testing.assert_array_equal(drive.brake_release, ~others)
    rig.run(Stop())
    assert CommandAborted("Calibrate") in rig.evrs
    np.testing.assert_array_equal(rig.outputs.joint.calibrated, others)
    missing = NOT_CALIBRATED.format(joint.name.lower())
    assert lab.refusal(rig, MoveJoints(floats(lab.START))) == missing
    assert lab.refusal(rig, MoveJoint(joint, float(lab.START[joint]))) == missing
    other = Joint((joint + 1) % 5)
    rig.begin(MoveJoint(other, float(lab.START[other]) + 0.01))
    assert CommandAccepted("MoveJoint") in rig.evrs


@pytest.mark.parametrize("kind", [Calibrate, CalibrateAll])
@pytest.mark.parametrize("calibrated", [True, False])
@pytest.mark.parametrize("joint", HARDSTOP_ORDER[1:])
def test_a_joint_looks_for_its_hardstop_only_where_the_others_are_out_of_its_way(kind, calibrated, joint):
    tolerance = lab.CONFIG.params.hardstop.pose_tolerance_rad
    for off_rad, refused in ((0.9 * tolerance, False), (1.1 * tolerance, True)):
        pose = lab.START + off_rad * (np.arange(5) == joint)
        rig = Rig(lab.CONFIG, start_rad=pose, calibrated=calibrated)
        rig.evrs.clear()
        rig.cycle(lab.COMMANDS[kind](rig))
        reasons = [evr.reason for evr in rig.evrs if isinstance(evr, CommandRefused)]
        assert bool(reasons) is refused
        if refused:
            (reason,) = reasons
            assert reason.startswith(f"joint {joint.name.lower()}: ")
            assert reason.endswith("where turret may be calibrated")


def next_to_its_stop(joint):
    """Return a rig without hardstops, with this joint close to the angle of its hardstop."""
    stop = lab.CONFIG.params.joints.in_order()[joint].hardstop_rad
    return Rig(lab.CONFIG, start_rad=np.where(np.arange(5) == joint, stop + 0.05, lab.START))


@pytest.mark.parametrize("joint", Joint)
def test_a_joint_that_meets_no_hardstop_is_stopped_behind_the_place_of_it(joint):
    rig = next_to_its_stop(joint)
    evrs = rig.run(Calibrate(joint))
    (missed,) = [evr for evr in evrs if isinstance(evr, HardstopMissed)]
    params = lab.CONFIG.params
    assert missed.joint is joint
    assert missed.stop_rad == params.joints.in_order()[joint].hardstop_rad
    assert missed.stop_rad - missed.angle_rad == pytest.approx(params.hardstop.window_rad, abs=1e-3)
    assert CommandAborted("Calibrate") in evrs
    assert rig.state.mode is Mode.FAULTED


@pytest.mark.parametrize("joint", Joint)
@pytest.mark.parametrize("beyond_m", slow_but([0.001, 0.01, 0.02], 0.001))
def test_a_stop_on_the_way_from_soft_limit_to_hardstop_is_no_fault(joint, beyond_m):
    rig = next_to_its_stop(joint)
    lowest = lab.CONFIG.protection.lowest_rad[joint] - beyond_m
    rig.cycle(Calibrate(joint))
    while rig.state.joints.motor_rad[joint] > lowest:
        rig.cycle()
    rig.run(Stop())
    assert CommandAborted("Calibrate") in rig.evrs
    assert not any(isinstance(evr, FaultResponse) for evr in rig.evrs)
    assert rig.state.mode is Mode.DEPLOYED


@pytest.mark.parametrize("cycles", [0, 40])
def test_all_joints_are_calibrated_by_commands_of_their_own_until_a_stop_ends_them(cycles):
    rig = lab.deployed()
    rig.cycle(CalibrateAll())
    assert rig.evrs[:2] == [CommandAccepted("CalibrateAll"), CommandAccepted("Calibrate")]
    assert rig.state.move.homing.joint is HARDSTOP_ORDER[0]
    assert rig.outputs.joint.busy
    for _ in range(cycles):
        rig.cycle()
    evrs = set(rig.run(Stop(), at_most=200))
    assert {CommandAborted("CalibrateAll"), CommandAborted("Calibrate"), CommandCompleted("Stop")} <= evrs
    assert rig.state.mode is Mode.DEPLOYED
    assert rig.state.sequence is None


@pytest.mark.parametrize(
    ("moving", "command", "end"),
    [
        (lab.moving_free, "MoveJoints", Mode.DEPLOYED),
        (lab.guarded_moving, "GuardedMove", Mode.GUARDED),
        (lab.retracting, "Retract", Mode.GUARDED),
    ],
    ids=["free space", "guarded", "retracting"],
)
def test_a_stop_slows_the_arm_and_the_move_is_aborted_without_a_fault(moving, command, end):
    rig = moving()
    last = np.abs(rig.outputs.drive.setpoint_rate_rad_s)
    first = len(rig.evrs)
    rig.cycle(Stop())
    while rig.outputs.joint.busy:
        rate = np.abs(rig.outputs.drive.setpoint_rate_rad_s)
        assert (rate <= last + 1e-12).all()
        last = rate
        rig.cycle()
    evrs = rig.evrs[first:]
    assert CommandAborted(command) in evrs
    assert CommandCompleted("Stop") in evrs
    assert CommandCompleted(command) not in evrs
    assert rig.state.mode is end
    assert not rig.outputs.drive.power_on.any()
    assert not rig.outputs.drive.brake_release.any()


@pytest.mark.parametrize("cycles", [None, *range(9)])
def test_a_stop_with_its_move_or_while_the_brakes_are_being_released_moves_nothing(cycles):
    rig, move = lab.deployed(), MoveJoints(floats(lab.START + 0.05))
    start = rig.count.copy()
    if cycles is None:
        evrs = rig.run(move, Stop(), at_most=60)
    else:
        rig.cycle(move)
        for _ in range(cycles):
            rig.cycle()
        evrs = rig.run(Stop(), at_most=60)
    assert CommandAborted("MoveJoints") in evrs
    assert np.abs(rig.count - start).max() <= (0 if cycles is None else 2)


@pytest.mark.parametrize("mode", [Mode.STOWED, Mode.DEPLOYED])
@pytest.mark.parametrize("tolerance_rad", [0.02, 0.15])
@pytest.mark.parametrize("joint", Joint)
def test_after_a_fault_the_angles_of_calibrated_joints_decide_whether_the_arm_is_stowed(
    mode, tolerance_rad, joint
):
    config = with_params(motion={"stow_tolerance_rad": tolerance_rad})
    near, far = tolerance_rad - 1e-3, tolerance_rad + 1e-3
    for off_rad, calibrated, end in (
        *((off, True, Mode.STOWED) for off in (0.0, near, -near)),
        *((off, True, Mode.DEPLOYED) for off in (far, -far)),
        (0.0, False, Mode.DEPLOYED),
    ):
        pose = np.array(config.params.poses.stowed_rad) + off_rad * (np.arange(5) == joint)
        rig = Rig(config, mode, pose, calibrated=calibrated)
        rig.go_blind()
        rig.cycle(ClearFault())
        assert rig.state.mode is end


@pytest.mark.parametrize(
    "kind", [Calibrate, CalibrateAll, MoveJoint, MoveJoints, MoveTool, GuardedMove, Retract]
)
def test_with_readings_that_cannot_be_used_nothing_begins(kind):
    rig = lab.deployed()
    reference = rig.state.joints.reference
    command = lab.COMMANDS[kind](rig)
    rig.state = replace(rig.state, readings=ReadingState())
    rig.cycle(command, winding_C=[lab.NAN] * 5)
    assert CommandRefused(kind.__name__, "a reading is unusable") in rig.evrs
    assert rig.state.move is None
    assert rig.state.sequence is None
    assert rig.state.joints.reference is reference


@pytest.mark.parametrize(
    ("make_rig", "end"),
    [
        (lab.deployed, Mode.DEPLOYED),
        (lab.moving_free, Mode.DEPLOYED),
        (lab.guarded_moving, Mode.GUARDED),
        (lab.guarded_in_contact, Mode.GUARDED),
        (lab.retracting, Mode.GUARDED),
    ],
)
def test_a_fault_cleared_with_all_switches_open_remembers_that_the_arm_may_touch(make_rig, end):
    rig = make_rig()
    mode = rig.state.mode
    rig.go_blind()
    assert rig.state.fault.mode is mode
    rig.run()
    for _ in range(3):  # a new fault in the cycle of ClearFault keeps what is known of the first one
        rig.cycle(ClearFault(), winding_C=[lab.NAN] * 5)
        assert rig.state.mode is Mode.FAULTED
    rig.cycle(ClearFault())
    assert rig.state.mode is end
    assert rig.state.fault is None


@pytest.mark.parametrize("make_rig", [lab.guarded_moving, lab.retracting, lab.guarded_in_contact])
def test_after_a_fault_where_it_may_touch_the_arm_retracts_before_it_moves_freely(make_rig):
    rig = make_rig()
    readings = lab.TOUCHED if make_rig in lab.TOUCHING else {}
    rig.go_blind(**readings)
    rig.run(winding_C=[lab.NAN] * 5, **readings)
    assert rig.state.mode is Mode.FAULTED
    rig.evrs.clear()
    rig.cycle(ClearFault(), **readings)
    assert FaultCleared() in rig.evrs
    rig.evrs.clear()
    rig.cycle(MoveJoints(floats(lab.START)), **readings)
    assert rig.evrs == [CommandRefused("MoveJoints", "not allowed in mode GUARDED")]
    rig.cycle(Retract("apxs", 0.02), **readings)
    for _ in range(30):
        rig.cycle(**readings)
    assert CommandCompleted("Retract") in rig.run()
    assert rig.state.mode is Mode.DEPLOYED


def test_a_step_that_is_refused_when_its_turn_comes_aborts_its_sequence():
    rig = lab.deployed()
    rig.state = replace(rig.state, sequence=Sequence("Process", (Hold(1.0, vibrate=True),)))
    rig.state = replace(rig.state, readings=ReadingState())
    rig.cycle(winding_C=[lab.NAN] * 5)
    assert rig.evrs[:2] == [CommandRefused("Hold", "a reading is unusable"), CommandAborted("Process")]
    assert rig.state.sequence is None


def test_only_the_first_of_two_moves_in_one_cycle_begins():
    rig = lab.deployed()
    rig.begin(MoveJoints(floats(lab.START + 0.05)), Retract("apxs", 0.1))
    assert CommandAccepted("MoveJoints") in rig.evrs
    assert CommandRefused("Retract", "MoveJoints is being planned") in rig.evrs


def test_a_stop_before_the_arm_has_left_its_stow_leaves_it_stowed():
    rig = lab.stowed()
    rig.begin(Unstow())
    rig.run(Stop(), at_most=200)
    assert rig.state.mode is Mode.STOWED
    rig.begin(Unstow())
    assert CommandAccepted("Unstow") in rig.evrs


def test_after_an_unforeseen_contact_the_tool_that_touched_is_the_one_to_retract():
    rig = lab.deployed()
    assert rig.state.tool != "apxs"
    rig.run(**lab.TOUCHED)
    assert rig.state.mode is Mode.FAULTED
    rig.cycle(ClearFault())
    assert (rig.state.mode, rig.state.tool) == (Mode.GUARDED, "apxs")
    for command in (Preload("drill", 100.0), Retract("drill", 0.05)):
        assert lab.refusal(rig, command) == "apxs is the tool that may touch; retract it first"
    rig.begin(Retract("apxs", 0.02), **lab.TOUCHED)
    assert CommandAccepted("Retract") in rig.evrs
