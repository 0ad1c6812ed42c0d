"""The last word on what goes out to the motors, whatever planned it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fsw.config import CYCLE_S
from fsw.dictionary.commands import MoveJoints
from fsw.dictionary.enums import Joint, Mode, Tool
from fsw.dictionary.evrs import CommandAborted, FaultResponse
from fsw.dictionary.faults import SetpointUnsafe
from fsw.motion.paths import Setpoint
from fsw.protect.motors import check_setpoint
from fsw.protect.status import MoveStatus
from tests.fsw.rig import Rig, config_of, facing, floats

CONFIG = config_of()
BOUNDS = CONFIG.params.monitors
LOW, HIGH = CONFIG.arm.soft_min_rad, CONFIG.arm.soft_max_rad
STEP = BOUNDS.setpoint_step_factor * CYCLE_S * CONFIG.speed_rad_s
START = facing(CONFIG, Tool.APXS)
BAD = [float("nan"), float("inf"), float("-inf")]


def unsafe_setpoint(last_rad, setpoint_rad, seeking=None):
    move = MoveStatus(setpoint_rad, np.zeros(5), False, False, seeking, None, None)
    return check_setpoint(CONFIG.protection, move, last_rad)


def at(joint, value, pose=START):
    return np.where(np.arange(5) == joint, value, pose)


@pytest.mark.parametrize("joint", Joint)
@pytest.mark.parametrize("value", BAD)
def test_what_is_no_number_does_not_go_out(joint, value):
    (evr,) = unsafe_setpoint(START, at(joint, value))
    assert isinstance(evr, SetpointUnsafe)
    assert evr.joint is joint
    assert evr.last_rad == START[joint]


@pytest.mark.parametrize("joint", Joint)
def test_nothing_goes_out_after_what_was_no_number(joint):
    assert unsafe_setpoint(at(joint, np.nan), START) != ()


@pytest.mark.parametrize("joint", Joint)
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_jump_is_a_step_larger_than_speed_and_factor_allow(joint, sign):
    for share, said in ((0.999, False), (1.001, True), (1e6, True)):
        asked = at(joint, START[joint] + sign * share * STEP[joint])
        found = unsafe_setpoint(START, asked)
        assert bool(found) is said
        if said:
            assert found == (SetpointUnsafe(joint, float(asked[joint]), float(START[joint])),)


@pytest.mark.parametrize("joint", Joint)
@pytest.mark.parametrize("end", ["min", "max"])
def test_beyond_limit_and_margin_a_set_point_may_stay_or_go_back_but_not_out(joint, end):
    outward, limit = (1, HIGH[joint]) if end == "max" else (-1, LOW[joint])
    edge = limit + outward * BOUNDS.soft_limit_margin_rad
    small = 0.1 * STEP[joint]
    for before, after, said in (
        (-2 * small, -small, False),
        (-small, small, True),
        (small, 2 * small, True),
        (small, small, False),
        (2 * small, small, False),
        (small, -small, False),
    ):
        last, asked = (at(joint, edge + outward * off) for off in (before, after))
        assert bool(unsafe_setpoint(last, asked)) is said


@pytest.mark.parametrize("joint", Joint)
@pytest.mark.parametrize("other", Joint)
def test_only_the_joint_that_seeks_its_hardstop_may_be_sent_there_and_not_far_beyond_it(joint, other):
    params = CONFIG.params
    stop = params.joints.in_order()[other].hardstop_rad
    small = 0.1 * STEP[other]
    for angle, said in ((stop, other is not joint), (stop - 2 * params.hardstop.window_rad, True)):
        found = unsafe_setpoint(at(other, angle + 0.5 * small), at(other, angle - 0.5 * small), joint)
        assert bool(found) is said


moves = hnp.arrays(float, 5, elements=st.floats(-1, 1))


@given(moves, moves)
def test_inside_the_limits_every_step_a_move_can_make_goes_out(where, step):
    last = LOW + (0.05 + 0.45 * (where + 1)) * (HIGH - LOW)
    asked = np.clip(last + step * CYCLE_S * CONFIG.speed_rad_s, LOW, HIGH)
    assert unsafe_setpoint(last, asked) == ()


def tampered(rig, setpoint_rad):
    """The move under way, its path replaced by one that asks for this: an error of planning."""

    class Wrong:
        duration_s = 10.0

        @staticmethod
        def at(time_s):
            return Setpoint(setpoint_rad, np.zeros(5))

    return replace(rig.state, move=replace(rig.state.move, paths=(Wrong(),), ticks=0))


@pytest.mark.parametrize("joint", Joint)
@pytest.mark.parametrize("wrong", ["nan", "jump"])
def test_a_wrong_path_ends_at_the_brakes_in_the_same_cycle_and_never_reaches_the_motors(joint, wrong):
    rig = Rig(CONFIG, start_rad=START)
    rig.until_moving(MoveJoints(floats(START + 0.05)))
    before = rig.outputs.drive.setpoint_count
    last = rig.state.move.setpoint.motor_rad
    asked = at(joint, np.nan if wrong == "nan" else last[joint] + 0.1, last)
    rig.state = tampered(rig, asked)
    rig.evrs.clear()
    drive = rig.cycle().drive
    assert isinstance(rig.evrs[0], SetpointUnsafe)
    assert rig.evrs[0].joint is joint
    assert rig.evrs[1] == FaultResponse("BRAKE_AND_REFUSE")
    assert rig.state.mode is Mode.FAULTED
    assert not drive.brake_release.any()
    assert not drive.setpoint_rate_rad_s.any()
    assert np.abs(drive.setpoint_count - before).max() <= 2
    rig.run()
    assert CommandAborted("MoveJoints") in rig.evrs
    assert not rig.outputs.drive.power_on.any()
