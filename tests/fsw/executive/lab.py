"""Rigs in every state in which a command may arrive, and a command of every type."""

from dataclasses import replace

import numpy as np

from fsw.dictionary import commands
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import CommandRefused, ModeChanged
from fsw.dictionary.params import TeachPoint
from fsw.motion.force_fit import MIN_CORRECTION_N
from tests.fsw.rig import Rig, config_of, facing, floats, made_once, with_params
from tests.tools import SWITCHES

START = facing(config_of(), "apxs")
STRONGER = replace(config_of().params.joints.elevation, hardstop_press_Nm=300.0)
"""Elevation with a larger pressing torque: in the ready pose gravity exceeds its share of the nominal one."""
_X_RT = Rig(with_params(), start_rad=START).tool_pose("apxs")
HERE = TeachPoint("here", "apxs", floats(_X_RT.p), floats(_X_RT.R[:, 0]))
"""Pose of the APXS at the start of these tests, as a taught point."""
CONFIG = with_params(
    hardstop={"start_rad": floats(START), "park_rad": floats(START), "second_start_rad": floats(START)},
    joints={"elevation": STRONGER},
    teach=(HERE,),
)
"""Configuration in which any joint may be homed from the pose in which these tests start."""
NAN = float("nan")
INF = float("inf")
TOUCHED = {"switch_closed": np.isin(SWITCHES, ["apxs_1"])}


@made_once
def stowed():
    return Rig(CONFIG, Mode.STOWED, CONFIG.params.poses.stowed_rad)


@made_once
def uncalibrated():
    rig = Rig(CONFIG, start_rad=START, calibrated=False)
    rig.cycle()
    return rig


@made_once
def deployed():
    return Rig(CONFIG, start_rad=START)


@made_once
def planning():
    rig = deployed()
    rig.cycle(commands.MoveJoints(floats(START + 0.05)))
    return rig


@made_once
def moving_free():
    rig = deployed()
    rig.until_moving(commands.MoveJoints(floats(START + 0.05)))
    return rig


@made_once
def guarded_moving():
    rig = deployed()
    rig.until_moving(rig.touch("apxs", 0.05))
    return rig


@made_once
def guarded_in_contact():
    rig = guarded_moving()
    rig.run(**TOUCHED)
    assert rig.state.mode is Mode.GUARDED
    return rig


@made_once
def retracting():
    rig = deployed()
    rig.until_moving(commands.Retract("apxs", 0.05))
    return rig


@made_once
def calibrating():
    rig = deployed()
    rig.until_moving(commands.Calibrate(Joint.TURRET))
    return rig


@made_once
def being_stopped_by_a_fault():
    rig = moving_free()
    rig.go_blind()
    return rig


@made_once
def faulted():
    rig = being_stopped_by_a_fault()
    rig.run()
    return rig


@made_once
def preloading():
    rig = guarded_in_contact()
    rig.begin(commands.Preload("apxs", 50.0), **TOUCHED)
    while rig.state.preload.force_N < 10.0:
        rig.cycle(**TOUCHED)
    return rig


@made_once
def preloaded():
    rig = preloading()
    rig.run(**TOUCHED)
    assert abs(rig.state.preload.force_N - 50.0) < MIN_CORRECTION_N
    return rig


RIGS = [
    stowed, uncalibrated, deployed, planning, moving_free, guarded_moving, guarded_in_contact, retracting,
    calibrating, preloading, preloaded, being_stopped_by_a_fault, faulted,
]  # fmt: skip
TOUCHING = (guarded_in_contact, preloading, preloaded)
"""Rigs with a closed switch."""


def _place(rig: Rig) -> commands.PlaceTool:
    ahead = rig.here("apxs", 0.02)
    return commands.PlaceTool("apxs", ahead.p_FoTo_F_m, ahead.approach_F, 0.02, 0.02)


COMMANDS = {
    commands.Calibrate: lambda rig: commands.Calibrate(Joint.TURRET),
    commands.CalibrateAll: lambda rig: commands.CalibrateAll(),
    commands.Unstow: lambda rig: commands.Unstow(),
    commands.Stow: lambda rig: commands.Stow(),
    commands.MoveJoint: lambda rig: commands.MoveJoint(
        Joint.WRIST, float(rig.state.joints.output_rad[Joint.WRIST])
    ),
    commands.MoveJoints: lambda rig: commands.MoveJoints(floats(rig.state.joints.motor_rad)),
    commands.MoveTool: lambda rig: rig.here("apxs"),
    commands.GuardedMove: lambda rig: rig.touch("apxs", 0.02),
    commands.PlaceTool: _place,
    commands.Preload: lambda rig: commands.Preload("apxs", 100.0),
    commands.ToolChange: lambda rig: commands.ToolChange("mahli"),
    commands.MoveTeachPoint: lambda rig: commands.MoveTeachPoint(HERE.name),
    commands.Dock: lambda rig: commands.Dock(HERE.name, 0.02),
    commands.Process: lambda rig: commands.Process("portion", (1.0, 0.0, 0.2), 1.0),
    commands.Retract: lambda rig: commands.Retract("apxs", 0.02),
    commands.SetTilt: lambda rig: commands.SetTilt(0.0, 0.0),
    commands.SetParam: lambda rig: commands.SetParam("motion.settle_time_s", 0.5),
    commands.Stop: lambda rig: commands.Stop(),
    commands.ClearFault: lambda rig: commands.ClearFault(),
}


def refusal(rig: Rig, command: commands.Command) -> str:
    """Return the reason for which a command is refused, and check that it changes nothing."""
    before = rig.state
    (evr,) = (evr for evr in rig.begin(command) if not isinstance(evr, ModeChanged))
    assert isinstance(evr, CommandRefused)
    assert evr.command == type(command).__name__
    assert rig.state.mode is before.mode
    assert rig.state.move is None
    assert rig.state.changed_config is before.changed_config
    assert rig.state.joints.down_R is before.joints.down_R
    assert not rig.outputs.drive.brake_release.any()
    return evr.reason
