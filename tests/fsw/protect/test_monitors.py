"""Each monitor provoked through the cycle: what it says, when, and what is done about it."""

import numpy as np
import pytest

from fsw.config import CYCLE_HZ, ticks
from fsw.dictionary.commands import ClearFault, MoveJoints, Retract
from fsw.dictionary.evrs import CommandAborted, CommandCompleted, ContactMade, Evr, FaultResponse
from fsw.dictionary.faults import (
    ContactInFreeSpace,
    CurrentImplausible,
    FollowingErrorHigh,
    GravityImplausible,
    HardstopMissed,
    HardstopMoved,
    HardstopUnclear,
    MotorStuck,
    NoContact,
    NoHardstop,
    NotSettled,
    OverCurrent,
    ResolverDisagrees,
    SensorNotFinite,
    SetpointUnsafe,
    SoftLimitPassed,
    StalledEarly,
)
from fsw.dictionary.joints import SWITCHES_OF, Joint, Switch, Tool
from fsw.dictionary.modes import Mode
from fsw.motion.move import Phase
from fsw.protect.responses import RESPONSE_TO, Response, response_to
from tests.fsw.rig import Rig, config_of, facing, floats

CONFIG = config_of()
BOUNDS = CONFIG.params.monitors
START = facing(CONFIG, Tool.APXS)
RESPONDED = FaultResponse("BRAKE_AND_REFUSE")


def closed(*switches):
    return {"switch_closed": np.isin(np.arange(len(Switch)), switches)}


def currents(joint, ampere):
    return {"current_A": np.where(np.arange(5) == joint, ampere, 0.0)}


def moving(command=None):
    rig = Rig(CONFIG, start_rad=START)
    rig.until_moving(command or MoveJoints(floats(START + 0.05)))
    rig.evrs.clear()
    return rig


def in_guarded_motion(tool=Tool.APXS):
    rig = Rig(CONFIG, start_rad=facing(CONFIG, tool))
    rig.until_moving(rig.touch(tool, 0.05), cycles=240)  # past the crossing of the gaps
    rig.evrs.clear()
    return rig


def braked(rig):
    drive = rig.outputs.drive
    return not drive.brake_release.any() and not drive.setpoint_rate_rad_s.any()


def found(rig, kind):
    return [evr for evr in rig.evrs if isinstance(evr, kind)]


@pytest.mark.parametrize("joint", Joint)
@pytest.mark.parametrize("sign", [1, -1])
def test_over_current_is_said_after_exactly_its_persistence(joint, sign):
    rig = moving()
    bound = BOUNDS.over_current_fraction * CONFIG.current_limit_A[joint]
    for _ in range(BOUNDS.over_current_persistence - 1):
        rig.cycle(**currents(joint, sign * bound * 1.001))
        assert rig.state.mode is Mode.FREE_SPACE
    rig.cycle(**currents(joint, sign * bound * 1.001))
    assert rig.evrs[:2] == [OverCurrent(joint, sign * bound * 1.001, bound), RESPONDED]
    assert rig.state.mode is Mode.FAULTED
    assert braked(rig)


def test_over_current_with_a_gap_counts_from_the_start():
    rig = moving()
    high = currents(Joint.ELBOW, 4.9)
    for _ in range(3):
        for _ in range(BOUNDS.over_current_persistence - 1):
            rig.cycle(**high)
        rig.cycle()
    assert not found(rig, OverCurrent)


def test_current_at_the_bound_is_no_fault():
    rig = moving()
    at_bound = {"current_A": BOUNDS.over_current_fraction * CONFIG.current_limit_A}
    for _ in range(2 * BOUNDS.over_current_persistence):
        rig.cycle(**at_bound)
    assert not found(rig, OverCurrent)


def off_set_point(rig, joint, rad):
    """A reading of the encoders that is this far from the set-point of the last cycle."""
    shift = np.where(np.arange(5) == joint, rad / CONFIG.rad_per_count, 0)
    return {"encoder_count": rig.count + np.rint(shift).astype(int)}


@pytest.mark.parametrize("joint", Joint)
def test_a_following_error_is_said_after_exactly_its_persistence(joint):
    rig = moving()
    for _ in range(BOUNDS.following_persistence - 1):
        rig.cycle(**off_set_point(rig, joint, -1.5 * BOUNDS.following_error_rad))
        assert rig.state.mode is Mode.FREE_SPACE
    rig.cycle(**off_set_point(rig, joint, -1.5 * BOUNDS.following_error_rad))
    (evr,) = found(rig, FollowingErrorHigh)
    assert evr.joint is joint
    assert evr.bound_rad == BOUNDS.following_error_rad
    assert evr.error_rad > evr.bound_rad
    assert RESPONDED in rig.evrs
    assert rig.state.mode is Mode.FAULTED
    assert braked(rig)


def test_a_following_error_with_a_gap_counts_from_the_start():
    rig = moving()
    for _ in range(3):
        for _ in range(BOUNDS.following_persistence - 1):
            rig.cycle(**off_set_point(rig, Joint.WRIST, -2 * BOUNDS.following_error_rad))
        rig.cycle()
    assert not found(rig, FollowingErrorHigh)


def test_a_motor_that_does_not_turn_ends_in_a_following_error():
    rig = Rig(CONFIG, start_rad=START)
    rig.stuck = True
    rig.run(MoveJoints(floats(START + 0.05)))
    assert found(rig, FollowingErrorHigh)
    assert CommandAborted("MoveJoints") in rig.evrs
    assert rig.state.mode is Mode.FAULTED


def encoders_at(rig, joint, angle_rad):
    """A reading of the encoders with one joint at this angle."""
    zero = rig.state.joints.reference.zero_rad[joint]
    count = np.rint((angle_rad - zero) / CONFIG.rad_per_count[joint]).astype(int)
    return {"encoder_count": np.where(np.arange(5) == joint, count, rig.count)}


def toward(joint, sign):
    """In the middle of a move of this joint, upward or downward."""
    pose = START + 0.1 * sign * (np.arange(5) == joint)
    return moving(MoveJoints(floats(pose)))


@pytest.mark.parametrize("joint", Joint)
@pytest.mark.parametrize("end", ["min", "max"])
def test_a_joint_moving_outward_beyond_soft_limit_and_margin_faults_at_once_and_within_it_does_not(
    joint, end
):
    outward = 1 if end == "max" else -1
    limit = getattr(CONFIG.arm, f"soft_{end}_rad")[joint]
    for beyond, faulted in ((-1e-5, False), (1e-5, True)):
        rig = toward(joint, outward)
        angle = limit + outward * (BOUNDS.soft_limit_margin_rad + beyond)
        rig.cycle(**encoders_at(rig, joint, angle))
        assert (rig.state.mode is Mode.FAULTED) is faulted
        if faulted:
            (evr,) = found(rig, SoftLimitPassed)
            assert evr.joint is joint
            assert evr.limit_rad == limit
            assert evr.angle_rad == pytest.approx(angle, abs=CONFIG.rad_per_count[joint])
            assert RESPONDED in rig.evrs
            assert braked(rig)


@pytest.mark.parametrize("joint", Joint)
@pytest.mark.parametrize("end", ["min", "max"])
def test_a_joint_beyond_its_limit_may_move_back_or_rest(joint, end):
    outward = 1 if end == "max" else -1
    angle = getattr(CONFIG.arm, f"soft_{end}_rad")[joint] + outward * 0.05
    rig = toward(joint, -outward)
    rig.cycle(**encoders_at(rig, joint, angle))
    assert not found(rig, SoftLimitPassed)
    rig = Rig(CONFIG, start_rad=START)
    for _ in range(5):
        rig.cycle(**encoders_at(rig, joint, angle))
    assert not found(rig, SoftLimitPassed)
    assert rig.state.mode is Mode.DEPLOYED


def test_joints_that_are_not_calibrated_rest_beyond_any_soft_limit_without_a_fault():
    rig = Rig(CONFIG, start_rad=START, calibrated=False)
    for _ in range(5):
        rig.cycle(encoder_count=np.full(5, 10**9))
    assert rig.state.mode is Mode.DEPLOYED


def resolver_off(rig, joint, off_rad):
    return {"resolver_rad": rig.resolver_rad() + off_rad * (np.arange(5) == joint)}


@pytest.mark.parametrize("joint", Joint)
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("start", [moving, lambda: Rig(CONFIG, start_rad=START)], ids=["moving", "resting"])
def test_a_resolver_may_be_off_by_its_bound_and_what_is_unknown_of_the_gap_and_no_more(joint, sign, start):
    for more_rad, said in ((-2e-4, False), (2e-4, True)):
        rig = start()
        for _ in range(300):
            bound = BOUNDS.resolver_error_rad + rig.state.joints.uncertainty_rad[joint]
            rig.cycle(**resolver_off(rig, joint, sign * (bound + more_rad)))
        assert bool(found(rig, ResolverDisagrees)) is said
        if said:
            (evr,) = found(rig, ResolverDisagrees)
            assert evr.joint is joint
            assert sign * evr.error_rad > evr.bound_rad >= BOUNDS.resolver_error_rad
            assert RESPONDED in rig.evrs
            assert rig.state.mode is Mode.FAULTED


@pytest.mark.parametrize("joint", Joint)
def test_a_resolver_that_reads_wrong_for_less_than_its_persistence_is_no_fault(joint):
    rig = moving()
    for _ in range(3):
        for _ in range(BOUNDS.resolver_persistence // 2):
            rig.cycle(**resolver_off(rig, joint, 0.01))
        for _ in range(2 * CYCLE_HZ):
            rig.cycle()
    assert not found(rig, ResolverDisagrees)


def test_a_resolver_of_a_joint_that_is_not_calibrated_disagrees_with_nothing():
    rig = Rig(CONFIG, start_rad=START, calibrated=False)
    rig.cycle()
    for _ in range(3 * BOUNDS.resolver_persistence):
        rig.cycle(resolver_rad=np.full(5, 1.0))
    assert not found(rig, ResolverDisagrees)


@pytest.mark.parametrize("switch", Switch)
def test_a_contact_in_free_space_faults_at_once(switch):
    rig = moving()
    rig.cycle(**closed(switch))
    assert rig.evrs[:2] == [ContactInFreeSpace(switch), RESPONDED]
    assert rig.state.mode is Mode.FAULTED
    assert braked(rig)


def test_a_contact_while_the_arm_stands_deployed_faults():
    rig = Rig(CONFIG, start_rad=START)
    rig.cycle(**closed(Switch.DRT_2))
    assert ContactInFreeSpace(Switch.DRT_2) in rig.evrs


@pytest.mark.parametrize("tool", [tool for tool in Tool if SWITCHES_OF[tool]])
def test_a_guarded_move_ends_at_the_contact_of_its_own_tool(tool):
    for switch in SWITCHES_OF[tool]:
        rig = in_guarded_motion(tool)
        rate = np.abs(rig.outputs.drive.setpoint_rate_rad_s).max()
        rig.cycle(**closed(switch))
        stands = rig.outputs.drive.setpoint_count
        assert rate > 0
        assert not rig.outputs.drive.setpoint_rate_rad_s.any()
        (evr,) = found(rig, ContactMade)
        assert evr.switch is switch
        assert 0 < evr.travel_m < 0.05
        rig.run(**closed(switch))
        np.testing.assert_array_equal(rig.outputs.drive.setpoint_count, stands)
        assert CommandCompleted("GuardedMove") in rig.evrs
        assert rig.state.mode is Mode.GUARDED
        assert not found(rig, FaultResponse)


def test_the_travel_at_contact_is_how_far_the_tool_went():
    rig = Rig(CONFIG, start_rad=START)
    start = rig.tool_pose(Tool.APXS).p
    rig.until_moving(rig.touch(Tool.APXS, 0.05), cycles=300)
    rig.cycle(**closed(Switch.APXS_2))
    (evr,) = found(rig, ContactMade)
    went = np.linalg.norm(rig.tool_pose(Tool.APXS).p - start)
    assert evr.travel_m == pytest.approx(went, abs=3e-4)


@pytest.mark.parametrize("switch", [s for s in Switch if s not in SWITCHES_OF[Tool.APXS]])
def test_the_contact_of_another_tool_in_a_guarded_move_is_a_fault(switch):
    rig = in_guarded_motion(Tool.APXS)
    rig.cycle(**closed(switch))
    assert ContactInFreeSpace(switch) in rig.evrs
    assert rig.state.mode is Mode.FAULTED


def test_no_contact_to_the_end_of_the_travel_is_a_fault_with_brakes():
    rig = Rig(CONFIG, start_rad=START)
    rig.evrs.clear()
    rig.cycle(rig.touch(Tool.APXS, 0.03))
    while rig.state.mode is Mode.GUARDED:
        rig.cycle()
    (evr,) = found(rig, NoContact)
    assert evr.travel_m == pytest.approx(0.03, abs=1e-6)
    assert RESPONDED in rig.evrs
    assert braked(rig)
    rig.run()
    assert CommandAborted("GuardedMove") in rig.evrs
    assert rig.state.mode is Mode.FAULTED
    assert not rig.outputs.drive.power_on.any()
    rig.run(ClearFault())
    assert CommandCompleted("Retract") in rig.run(Retract(Tool.APXS, 0.02))


def test_a_motor_that_does_not_come_to_rest_is_a_fault_after_its_time():
    rig = moving(MoveJoints(floats(START + 0.002)))
    settle_error = CONFIG.params.motion.settle_error_rad
    cycles = 0
    while rig.outputs.joint.busy and cycles < 2000:
        rig.cycle(**off_set_point(rig, Joint.TURRET, 3 * settle_error))
        cycles += 1
    (evr,) = found(rig, NotSettled)
    assert evr.joint is Joint.TURRET
    assert evr.error_rad == pytest.approx(3 * settle_error, rel=0.2)
    assert RESPONDED in rig.evrs
    assert rig.state.mode is Mode.FAULTED
    assert cycles > CONFIG.settle_timeout_ticks


def test_calm_is_counted_in_whole_cycles_in_a_row():
    rig = moving(MoveJoints(floats(START + 0.002)))
    while rig.state.move.phase is not Phase.SETTLE:
        rig.cycle()
    for k in range(5 * CONFIG.settle_ticks):
        far = k % CONFIG.settle_ticks == 0
        rig.cycle(**(off_set_point(rig, Joint.TURRET, 1e-3) if far else {}))
    assert rig.outputs.drive.brake_release.all()
    for _ in range(CONFIG.settle_ticks + CONFIG.brake_ticks + 3):
        rig.cycle()
    assert CommandCompleted("MoveJoints") in rig.evrs


def test_brakes_hold_before_power_goes_off_and_let_go_before_anything_moves():
    rig = Rig(CONFIG, start_rad=START)
    start = rig.count.copy()
    rig.cycle(MoveJoints(floats(START + 0.002)))
    released_for = 0
    while np.array_equal(rig.outputs.drive.setpoint_count, start):
        assert rig.outputs.drive.power_on.all()
        assert rig.outputs.drive.brake_release.all()
        released_for += 1
        rig.cycle()
    assert released_for >= ticks(CONFIG.params.motion.brake_delay_s)
    while rig.outputs.drive.brake_release.any():
        rig.cycle()
    powered_for = 0
    while rig.outputs.drive.power_on.any():
        powered_for += 1
        rig.cycle()
    assert powered_for >= ticks(CONFIG.params.motion.brake_delay_s)


def test_every_fault_has_a_response_and_every_response_is_used():
    assert set(RESPONSE_TO) == {
        SensorNotFinite,
        GravityImplausible,
        SetpointUnsafe,
        SoftLimitPassed,
        OverCurrent,
        FollowingErrorHigh,
        ContactInFreeSpace,
        CurrentImplausible,
        HardstopMissed,
        HardstopMoved,
        HardstopUnclear,
        MotorStuck,
        NoHardstop,
        ResolverDisagrees,
        StalledEarly,
        NoContact,
        NotSettled,
    }
    assert set(RESPONSE_TO.values()) == set(Response)


def test_what_is_no_fault_has_no_response():
    quiet: tuple[Evr, ...] = (
        CommandCompleted("Stop"),
        ContactMade(Switch.APXS_1, 0.1),
        CommandAborted("Stop"),
    )
    assert response_to(quiet) is None
    assert response_to(()) is None
    assert response_to((*quiet, NoContact(0.1))) is Response.BRAKE_AND_REFUSE


def test_an_arm_that_faulted_in_contact_can_be_cleared_and_then_retracted():
    rig = in_guarded_motion()
    contact = closed(Switch.APXS_1)
    rig.run(**contact)
    rig.cycle(**contact, current_A=[np.nan] * 5)
    rig.cycle(ClearFault(), **contact)
    assert rig.state.mode is Mode.GUARDED
    rig.cycle(Retract(Tool.APXS, 0.02), **contact)
    for _ in range(30):
        rig.cycle(**contact)
    assert CommandCompleted("Retract") in rig.run()


@pytest.mark.parametrize("joint", Joint)
@pytest.mark.parametrize("end", ["min", "max"])
def test_an_arm_beyond_a_soft_limit_can_be_cleared_and_moved_back(joint, end):
    outward = 1 if end == "max" else -1
    pose = START.copy()
    limit = getattr(CONFIG.arm, f"soft_{end}_rad")[joint]
    pose[joint] = limit + outward * (BOUNDS.soft_limit_margin_rad + 1e-3)
    rig = Rig(CONFIG, start_rad=pose)
    rig.cycle(current_A=[np.nan] * 5)
    rig.cycle(ClearFault())
    assert rig.state.mode is Mode.DEPLOYED
    back = pose.copy()
    back[joint] = limit - outward * 0.05
    assert CommandCompleted("MoveJoints") in rig.run(MoveJoints(floats(back)))


@pytest.mark.parametrize("joint", Joint)
@pytest.mark.parametrize("off_rad", [-0.3, -0.0025, 0.0015, 0.0025, 5.0])
def test_a_fault_holds_what_is_read_but_no_farther_from_the_set_point_than_a_motor_may_follow(joint, off_rad):
    rig = moving()
    last = rig.state.move.hold.motor_rad
    rig.cycle(**off_set_point(rig, joint, off_rad), switch_closed=closed(Switch.DRT_1)["switch_closed"])
    assert rig.state.mode is Mode.FAULTED
    held = rig.state.move.hold.motor_rad - last
    bound = BOUNDS.following_error_rad
    assert held[joint] == pytest.approx(np.clip(off_rad, -bound, bound), abs=2e-5)
    assert braked(rig)
