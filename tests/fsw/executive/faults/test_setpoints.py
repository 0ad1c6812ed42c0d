"""The last word on what goes out to the motors, whatever planned it."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.commands import MoveJoints
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import CommandAborted, FaultResponse
from fsw.dictionary.faults import SetpointUnsafe
from fsw.motion.paths import Setpoint
from tests.fsw.rig import Rig, config_of, facing, floats

CONFIG = config_of()
START = facing(CONFIG, "apxs")


def at(joint, value, pose=START):
    return np.where(np.arange(5) == joint, value, pose)


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
    commanded = at(joint, np.nan if wrong == "nan" else last[joint] + 0.1, last)
    rig.state = tampered(rig, commanded)
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
