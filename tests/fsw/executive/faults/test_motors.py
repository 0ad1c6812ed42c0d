"""What motors do that they should not: too far, too slow, too much current, too hot, too cold."""

import numpy as np
import pytest

from fsw.dictionary.commands import MoveJoints
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.faults import Fault, MotorStalled, NotSettled
from helpers.marks import slow_but
from tests.fsw.executive.faults.lab import (
    BOUNDS,
    CONFIG,
    REFUSED,
    START,
    braked,
    found,
    in_guarded_motion,
    moving,
    off_set_point,
    resolver_off,
)
from tests.fsw.rig import Rig, floats


def seize(rig, joint):
    """The encoders from now on, of an arm whose joint does not turn any more."""
    stood = rig.count[joint]
    return lambda: {"encoder_count": np.where(np.arange(5) == joint, stood, rig.count)}


def lag_rad(rig, joint):
    return abs(rig.state.move.setpoint.motor_rad - rig.state.joints.motor_rad)[joint]


@pytest.mark.parametrize("joint", Joint)
@pytest.mark.parametrize("cycles", slow_but([1, 10, 30, 60, 90, 120], 1, 60))
def test_a_joint_that_seizes_is_stalled_before_it_is_too_far_behind_however_slow_it_was(joint, cycles):
    goal = START + 0.05 * (np.arange(5) == joint)
    rig = Rig(CONFIG, start_rad=START)
    rig.cycle(MoveJoints(floats(goal)))
    for _ in range(cycles):
        rig.cycle()
    rig.evrs.clear()
    reading, beyond = seize(rig, joint), 0
    while not found(rig, Fault):
        rig.cycle(**reading())
        beyond += lag_rad(rig, joint) > BOUNDS.stall_error_rad
    (evr,) = found(rig, Fault)
    assert evr == MotorStalled(joint, 0.0, evr.commanded_rad_s)
    assert evr.commanded_rad_s > 0
    # in the cycle of the response the set-point is back where the motor is
    assert BOUNDS.stall_persistence - 1 <= beyond <= BOUNDS.stall_persistence + 1
    assert REFUSED in rig.evrs
    assert rig.state.mode is Mode.FAULTED
    assert braked(rig)


@pytest.mark.parametrize("joint", slow_but(Joint, Joint.ELBOW, Joint.TURRET))
def test_a_motor_that_lags_by_what_friction_takes_has_not_stalled(joint):
    """From the very start of the motion to its end, and on the way to a contact."""
    commands = (MoveJoints(floats(START + 0.02)), MoveJoints(floats(START)))
    for command in commands:
        rig = Rig(CONFIG, start_rad=START)
        rig.cycle(command)
        while rig.outputs.joint.busy:
            rate = rig.outputs.drive.setpoint_rate_rad_s[joint]
            behind = BOUNDS.stall_error_rad * np.sign(rate) * (abs(rate) > 1e-6)
            lag = resolver_off(rig, joint, -0.9 * behind)  # the output lags as its motor does
            rig.cycle(**off_set_point(rig, joint, -0.9 * behind), **lag)
        assert not found(rig, Fault)
    rig = in_guarded_motion()
    for _ in range(100):
        rig.cycle(**off_set_point(rig, joint, -0.9 * BOUNDS.stall_error_rad))
    assert not found(rig, Fault)


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
    assert REFUSED in rig.evrs
    assert rig.state.mode is Mode.FAULTED
    assert cycles > CONFIG.settle_timeout_ticks
