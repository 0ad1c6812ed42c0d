"""What motors do that they should not: too far, too slow, too much current, too hot, too cold."""

import numpy as np
import pytest

from fsw.dictionary.commands import MoveJoints
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.faults import Fault, NotSettled
from helpers.marks import slow_but
from tests.fsw.executive.faults.lab import (
    BOUNDS,
    CONFIG,
    REFUSED,
    START,
    found,
    in_guarded_motion,
    moving,
    off_set_point,
    resolver_off,
)
from tests.fsw.rig import Rig, floats


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
