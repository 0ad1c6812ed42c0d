"""Contact where there should be none, none where there should be some, and too much force."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fsw.dictionary.commands import ClearFault, Preload, Retract, Stop
from fsw.dictionary.enums import TOOL_SWITCHES, Mode, Switch, Tool
from fsw.dictionary.evrs import CommandAborted, CommandCompleted, ContactMade, FaultResponse
from fsw.dictionary.faults import ContactInFreeSpace, ContactLost, NoContact, PreloadOutside
from fsw.executive.protection import describe_arm
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.statics import settle_output
from fsw.motion.plan import Refusal
from fsw.motion.preload import holding_force_N
from fsw.protect.contact import (
    FULL_LEVER_M,
    LEAST_LEVER_M,
    check_contact_kept,
    check_press_force,
    estimate_force_error,
)
from fsw.protect.status import PressStatus
from tests.fsw.protect.lab import (
    BOUNDS,
    CONFIG,
    REFUSED,
    START,
    braked,
    closed,
    found,
    in_guarded_motion,
    moving,
)
from tests.fsw.rig import MARS_R_m_s2, Rig

NOT_OFF = np.zeros(5)


@pytest.mark.parametrize("switch", Switch)
def test_a_contact_in_free_space_faults_at_once(switch):
    rig = moving()
    rig.cycle(**closed(switch))
    assert rig.evrs[:2] == [ContactInFreeSpace(switch), REFUSED]
    assert rig.state.mode is Mode.FAULTED
    assert braked(rig)


def test_a_contact_while_the_arm_stands_deployed_faults():
    rig = Rig(CONFIG, start_rad=START)
    rig.cycle(**closed(Switch.DRT_2))
    assert ContactInFreeSpace(Switch.DRT_2) in rig.evrs


@pytest.mark.parametrize("tool", [tool for tool in Tool if TOOL_SWITCHES[tool]])
def test_a_guarded_move_ends_at_the_contact_of_its_own_tool(tool):
    for switch in TOOL_SWITCHES[tool]:
        rig = in_guarded_motion(tool)
        rate = np.abs(rig.outputs.drive.setpoint_rate_rad_s).max()
        rig.cycle(**closed(switch))
        assert rate > 0
        (evr,) = found(rig, ContactMade)
        assert evr.switch is switch
        assert 0 < evr.travel_m < 0.05
        rig.run(**closed(switch))
        assert rig.state.preload.tool is tool
        assert rig.state.preload.force_N == pytest.approx(holding_force_N(CONFIG))
        assert rig.outputs.joint.planned_gap_rad == pytest.approx(rig.outputs.joint.gap_rad, abs=1e-5)
        assert not rig.outputs.drive.setpoint_rate_rad_s.any()
        assert CommandCompleted("GuardedMove") in rig.evrs
        assert rig.state.mode is Mode.GUARDED
        assert not found(rig, FaultResponse)


def test_a_contact_that_is_lost_while_it_is_made_firm_stops_the_move():
    rig = in_guarded_motion(Tool.APXS)
    rig.cycle(**closed(Switch.APXS_1))
    rig.run()
    assert found(rig, ContactLost)
    assert CommandAborted("GuardedMove") in rig.evrs


def test_a_stop_while_a_contact_is_made_firm_keeps_what_it_presses_with():
    rig = in_guarded_motion(Tool.APXS)
    for _ in range(150):
        rig.cycle(**closed(Switch.APXS_1))
    rig.run(Stop(), **closed(Switch.APXS_1))
    assert rig.state.mode is Mode.GUARDED
    assert CONFIG.params.motion.switch_force_N <= rig.state.preload.force_N < holding_force_N(CONFIG)


def test_a_guarded_move_that_touches_before_it_moves_presses_no_further():
    rig = in_guarded_motion(Tool.APXS)
    rig.run(**closed(Switch.APXS_1))
    pressing, motor_rad = rig.state.preload, rig.state.joints.motor_rad
    rig.run(rig.touch(Tool.APXS, 0.05), **closed(Switch.APXS_1))
    assert rig.state.preload is pressing
    assert rig.state.joints.motor_rad == pytest.approx(motor_rad, abs=CONFIG.params.motion.settle_error_rad)


def test_a_touch_that_may_not_press_stays_where_its_switch_closed(monkeypatch):
    monkeypatch.setattr("fsw.motion.move.plan_preload", lambda *_: Refusal("for this test"))
    rig = in_guarded_motion(Tool.APXS)
    rig.cycle(**closed(Switch.APXS_1))
    rig.run(**closed(Switch.APXS_1))
    assert CommandCompleted("GuardedMove") in rig.evrs
    assert rig.state.preload is None


def test_a_touch_can_be_released_before_it_is_pressed():
    rig = in_guarded_motion(Tool.APXS)
    rig.run(**closed(Switch.APXS_1))
    rig.run(Preload(Tool.APXS, 0.0), **closed(Switch.APXS_1))
    assert CommandCompleted("Preload") in rig.evrs
    assert rig.state.preload.force_N == 0.0


def test_a_fault_by_the_contact_of_another_tool_ends_what_the_first_pressed_with():
    rig = in_guarded_motion(Tool.APXS)
    rig.run(**closed(Switch.APXS_1))
    rig.cycle(**closed(Switch.DRT_1))
    rig.run(**closed(Switch.DRT_1))
    rig.run(ClearFault(), **closed(Switch.DRT_1))
    assert rig.state.tool is Tool.DRT
    assert rig.state.preload is None


def test_the_travel_at_contact_is_how_far_the_tool_went():
    rig = Rig(CONFIG, start_rad=START)
    start = rig.tool_pose(Tool.APXS).p
    rig.until_moving(rig.touch(Tool.APXS, 0.05), cycles=300)
    rig.cycle(**closed(Switch.APXS_2))
    (evr,) = found(rig, ContactMade)
    went = np.linalg.norm(rig.tool_pose(Tool.APXS).p - start)
    assert evr.travel_m == pytest.approx(went, abs=3e-4)


@pytest.mark.parametrize("switch", [s for s in Switch if s not in TOOL_SWITCHES[Tool.APXS]])
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
    assert REFUSED in rig.evrs
    assert braked(rig)
    rig.run()
    assert CommandAborted("GuardedMove") in rig.evrs
    assert rig.state.mode is Mode.FAULTED
    assert not rig.outputs.drive.power_on.any()
    rig.run(ClearFault())
    assert CommandCompleted("Retract") in rig.run(Retract(Tool.APXS, 0.02))


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


PRESSING = [tool for tool in Tool if TOOL_SWITCHES[tool]]


def pressed(tool, force_N=300.0, per_N=NOT_OFF, at_touch_rad=NOT_OFF):
    return PressStatus(tool, force_N, per_N, at_touch_rad)


def force_error_N(per_N, arm, at_touch_rad=NOT_OFF):
    return estimate_force_error(CONFIG.protection, arm, pressed(Tool.DRILL, 0.0, per_N, at_touch_rad))


@pytest.mark.parametrize("tool", PRESSING)
def test_a_contact_is_lost_when_no_switch_of_the_tool_has_been_closed_for_exactly_its_persistence(tool):
    others = [switch for switch in Switch if switch not in TOOL_SWITCHES[tool]]
    count = 0
    for cycle in range(1, 2 * BOUNDS.contact_persistence):
        count, evrs = check_contact_kept(
            CONFIG.protection, count, pressed(tool), closed(*others)["switch_closed"]
        )
        assert evrs == ((ContactLost(tool),) if cycle >= BOUNDS.contact_persistence else ())


@pytest.mark.parametrize("tool", PRESSING)
def test_one_closed_switch_is_contact_whichever_it_is_and_counting_begins_anew(tool):
    for switch in TOOL_SWITCHES[tool]:
        assert check_contact_kept(CONFIG.protection, 100, pressed(tool), closed(switch)["switch_closed"]) == (
            0,
            (),
        )


def test_a_tool_that_hardly_presses_may_have_its_switches_open():
    light = pressed(Tool.DRILL, CONFIG.params.preload.step_N)
    assert check_contact_kept(CONFIG.protection, 100, light, closed()["switch_closed"]) == (0, ())


def torque_per_N(tool):
    """By virtual work: how far each joint moves the tool along its axis, by finite differences."""
    X = tool_pose(CONFIG.arm, settle_output(CONFIG.arm, START, MARS_R_m_s2).frames, tool)

    def along_m(step):
        X_RT = tool_pose(CONFIG.arm, settle_output(CONFIG.arm, START + step, MARS_R_m_s2).frames, tool)
        return X_RT.p @ X.R[:, 0]

    return np.array([along_m(-step) - along_m(step) for step in 1e-5 * np.eye(5)]) / 2e-5


def known(error_rad, uncertainty_rad=0.0):
    """Joints whose resolvers are off by so much, and whose gears are known to so much."""
    joints = Rig(CONFIG, start_rad=START).state.joints
    arm = describe_arm(Mode.PRELOAD, Tool.DRILL, joints, np.full(5, uncertainty_rad), None, None)
    return replace(arm, resolver_error_rad=np.asarray(error_rad, float))


@pytest.mark.parametrize("tool", PRESSING)
@given(st.floats(-500.0, 500.0))
def test_a_force_that_nobody_believes_in_is_found_from_the_wind_up_of_the_gears(tool, force_N):
    per_N = torque_per_N(tool)
    joints = known(force_N * per_N / CONFIG.arm.gear_stiffness_Nm_rad)
    found_N, lever_m = force_error_N(per_N, joints)
    # what joints with less leverage together would say is not listened to
    expected_N = force_N if lever_m > LEAST_LEVER_M else 0.0
    assert found_N == pytest.approx(expected_N, rel=1e-9, abs=1e-9)
    assert lever_m > LEAST_LEVER_M or tool is not Tool.DRILL


def test_a_torque_that_no_force_on_the_tool_takes_is_no_force():
    per_N, stiffness = torque_per_N(Tool.DRILL), CONFIG.arm.gear_stiffness_Nm_rad
    torque = np.random.default_rng(8).uniform(-100.0, 100.0, 5)
    fitted_N, _ = force_error_N(per_N, known(torque / stiffness))
    left = known((torque - fitted_N * per_N) / stiffness)
    assert fitted_N != 0
    assert force_error_N(per_N, left)[0] == pytest.approx(0.0, abs=1e-9)


def test_what_is_not_known_of_a_gear_is_taken_for_no_force():
    per_N = torque_per_N(Tool.DRILL)
    joints = known(np.full(5, 2e-3), uncertainty_rad=2e-3)
    assert force_error_N(per_N, joints)[0] == 0.0
    unknown = replace(known(np.ones(5)), calibrated=np.zeros(5, bool))
    assert force_error_N(per_N, unknown)[0] == 0.0


@pytest.mark.parametrize("sign", [1, -1])
def test_a_preload_outside_its_bounds_is_said_after_exactly_its_persistence(sign):
    per_N = torque_per_N(Tool.DRILL)
    for share, said in ((0.99, False), (1.01, True)):
        _, lever_m = force_error_N(per_N, known(np.zeros(5)))
        known_N = BOUNDS.preload_error_N + CONFIG.params.preload.error_share * 300.0
        bound_N = known_N * max(1.0, FULL_LEVER_M / lever_m)
        error_N, count = sign * share * bound_N, 0
        joints = known(error_N * per_N / CONFIG.arm.gear_stiffness_Nm_rad)
        for cycle in range(1, 2 * BOUNDS.preload_persistence):
            count, evrs = check_press_force(
                CONFIG.protection, count, joints, pressed(Tool.DRILL, per_N=per_N)
            )
            assert bool(evrs) is (said and cycle >= BOUNDS.preload_persistence)
        if said:
            (evr,) = evrs
            assert evr == PreloadOutside(Tool.DRILL, 300.0, evr.error_N, bound_N)
            assert evr.error_N == pytest.approx(error_N)


def test_what_the_resolvers_were_off_at_the_touch_is_no_force():
    per_N = np.array([0.0, 0.8, 0.1, 0.2, 0.0])
    joints = known(np.array([0.0, 8e-4, 1e-4, 0.0, 0.0]))
    assert force_error_N(per_N, joints)[0] > 50.0
    assert force_error_N(per_N, joints, joints.resolver_error_rad)[0] == 0.0
