"""Contact where there should be none, none where there should be some, and too much force."""

import numpy as np
import pytest

from fsw.dictionary.commands import ClearFault, Preload, Retract, Stop
from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import CommandAborted, CommandCompleted, ContactMade, FaultResponse
from fsw.dictionary.faults import ContactInFreeSpace, ContactLost, NoContact
from fsw.motion.plan import Refusal
from fsw.motion.preload import holding_force_N
from helpers.marks import slow_but
from tests.fsw.executive.faults.lab import (
    CONFIG,
    REFUSED,
    START,
    braked,
    closed,
    found,
    in_guarded_motion,
    moving,
)
from tests.fsw.rig import Rig, made_once
from tests.tools import SWITCHES, TOOL_SWITCHES, TOOLS


@pytest.mark.parametrize("switch", SWITCHES)
def test_a_contact_in_free_space_faults_at_once(switch):
    rig = moving()
    rig.cycle(**closed(switch))
    assert rig.evrs[:2] == [ContactInFreeSpace(switch), REFUSED]
    assert rig.state.mode is Mode.FAULTED
    assert braked(rig)


@pytest.mark.parametrize("tool", slow_but([tool for tool in TOOLS if TOOL_SWITCHES[tool]], "apxs", "drill"))
def test_a_guarded_move_ends_at_the_contact_of_its_own_tool(tool):
    for switch in TOOL_SWITCHES[tool]:
        rig = in_guarded_motion(tool)
        rate = np.abs(rig.outputs.drive.setpoint_rate_rad_s).max()
        rig.cycle(**closed(switch))
        assert rate > 0
        (evr,) = found(rig, ContactMade)
        assert evr.switch == switch
        assert 0 < evr.travel_m < 0.05
        rig.run(**closed(switch))
        assert rig.state.preload.tool == tool
        assert rig.state.preload.force_N == pytest.approx(holding_force_N(CONFIG))
        assert rig.outputs.joint.planned_backlash_rad == pytest.approx(
            rig.outputs.joint.backlash_rad, abs=1e-5
        )
        assert not rig.outputs.drive.setpoint_rate_rad_s.any()
        assert CommandCompleted("GuardedMove") in rig.evrs
        assert rig.state.mode is Mode.GUARDED
        assert not found(rig, FaultResponse)


def test_a_contact_that_is_lost_while_it_is_made_firm_stops_the_move():
    rig = in_guarded_motion("apxs")
    rig.cycle(**closed("apxs_1"))
    rig.run()
    assert found(rig, ContactLost)
    assert CommandAborted("GuardedMove") in rig.evrs


@made_once
def touched():
    """A tool that has touched and pressed."""
    rig = in_guarded_motion("apxs")
    rig.run(**closed("apxs_1"))
    return rig


def test_a_stop_while_a_contact_is_made_firm_keeps_what_it_presses_with():
    rig = in_guarded_motion("apxs")
    for _ in range(150):
        rig.cycle(**closed("apxs_1"))
    rig.run(Stop(), **closed("apxs_1"))
    assert rig.state.mode is Mode.GUARDED
    assert CONFIG.params.motion.switch_force_N <= rig.state.preload.force_N < holding_force_N(CONFIG)


def test_a_guarded_move_that_touches_before_it_moves_presses_no_further_and_can_be_released():
    rig = touched()
    pressing, motor_rad = rig.state.preload, rig.state.joints.motor_rad
    rig.run(rig.touch("apxs", 0.05), **closed("apxs_1"))
    assert rig.state.preload is pressing
    assert rig.state.joints.motor_rad == pytest.approx(motor_rad, abs=CONFIG.params.motion.settle_error_rad)
    assert CommandCompleted("Preload") in rig.run(Preload("apxs", 0.0), **closed("apxs_1"))
    assert rig.state.preload.force_N == 0.0


def test_a_touch_that_may_not_press_stays_where_its_switch_closed(monkeypatch):
    monkeypatch.setattr("fsw.motion.move.plan_preload", lambda *_: Refusal("for this test"))
    rig = in_guarded_motion("apxs")
    rig.cycle(**closed("apxs_1"))
    rig.run(**closed("apxs_1"))
    assert CommandCompleted("GuardedMove") in rig.evrs
    assert rig.state.preload is None


def test_a_fault_by_the_contact_of_another_tool_ends_what_the_first_pressed_with():
    rig = touched()
    rig.run(**closed("drt_1"))
    rig.run(ClearFault(), **closed("drt_1"))
    assert rig.state.tool == "drt"
    assert rig.state.preload is None


def test_the_travel_at_contact_is_how_far_the_tool_went():
    rig = Rig(CONFIG, start_rad=START)
    start = rig.tool_pose("apxs").p
    rig.until_moving(rig.touch("apxs", 0.05), cycles=300)
    rig.cycle(**closed("apxs_2"))
    (evr,) = found(rig, ContactMade)
    went = np.linalg.norm(rig.tool_pose("apxs").p - start)
    assert evr.travel_m == pytest.approx(went, abs=3e-4)


def test_no_contact_to_the_end_of_the_travel_is_a_fault_with_brakes():
    rig = Rig(CONFIG, start_rad=START)
    rig.evrs.clear()
    rig.cycle(rig.touch("apxs", 0.03))
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
    assert CommandCompleted("Retract") in rig.run(Retract("apxs", 0.02))
