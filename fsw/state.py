"""The state of flight software: one frozen record from cycle to cycle."""

from dataclasses import dataclass

import numpy as np

from fsw.config import Config
from fsw.dictionary.channels import JointChannels
from fsw.dictionary.commands import Command
from fsw.dictionary.enums import Mode, Tool
from fsw.estimate.joints import JointEstimate, LoadEstimate, no_load, uninitialised_estimate
from fsw.estimate.reference import Reference, no_reference
from fsw.kinematics.transforms import Array
from fsw.messages import ActuatorCommand, Outputs
from fsw.motion.move import Move
from fsw.motion.preload import PreloadState
from fsw.protect.monitors import MonitorState
from fsw.protect.responses import StandingFault


@dataclass(frozen=True, slots=True)
class Hold:
    """Frozen record of a step that stands on the brakes for a while."""

    duration_s: float
    vibrate: bool


SequenceStep = Command | Hold


@dataclass(frozen=True, slots=True)
class Sequence:
    """Frozen record of what is still to come of a command that takes several moves."""

    command: str
    remaining: tuple[SequenceStep, ...]


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Everything that a cycle leaves for the next one."""

    tick: int
    mode: Mode
    tool: Tool
    """The tool of the last tool command; the tool channels are about it."""
    joints: JointEstimate
    load: LoadEstimate
    planned_gap_rad: Array
    """Where the set-points assume the outputs to lie in their backlash."""
    move: Move | None
    """None while the arm stands on its brakes."""
    preload: PreloadState | None
    """What the tool that touches was pressed with last; None since it has been moved."""
    sequence: Sequence | None
    """Commands that are still to come of one that takes several."""
    fault: StandingFault | None
    monitors: MonitorState
    drive: ActuatorCommand
    changed_config: Config | None = None
    """The configuration with the parameters that were set since boot; None if none was."""


def boot(config: Config, mode: Mode, reference: Reference | None = None) -> State:
    """The state before the first cycle: brakes on, power off, and what was remembered of the joints."""
    n = config.rad_per_count.size
    off = np.zeros(n, bool)
    return State(
        tick=0,
        mode=mode,
        tool=Tool.DRILL,
        joints=uninitialised_estimate(config, no_reference(config) if reference is None else reference),
        load=no_load(n),
        planned_gap_rad=np.zeros(n),
        move=None,
        preload=None,
        sequence=None,
        fault=None,
        monitors=MonitorState(),
        drive=ActuatorCommand(
            np.zeros(n, np.int64), np.zeros(n), config.current_limit_A, off, off, vibrate=False
        ),
    )


def outputs_at_rest(state: State) -> Outputs:
    """What flight software would put out if nothing happened: the last drive, the channels as they are."""
    return Outputs(state.drive, joint_channels(state.tick, state, state.joints.backlash_state), None, ())


def last_setpoint(state: State) -> Array:
    """The motor angles that were asked for last: a move's set-point, or where the brakes hold the motors."""
    return state.joints.motor_rad if state.move is None else state.move.setpoint.motor_rad


def joint_channels(tick: int, state: State, lie: Array) -> JointChannels:
    """Return the channels of a cycle that left this state; `lie` is that of its joint estimate, (3, 5)."""
    joints = state.joints
    gap_rad, gap_side, gap_uncertainty_rad = lie
    return JointChannels(
        tick=tick,
        mode=state.mode,
        busy=state.move is not None or state.sequence is not None,
        motor_rad=joints.motor_rad,
        motor_rate_rad_s=joints.motor_rate_rad_s,
        setpoint_rad=last_setpoint(state),
        output_rad=joints.output_rad,
        gap_rad=gap_rad,
        gap_side=gap_side,
        gap_uncertainty_rad=gap_uncertainty_rad,
        planned_gap_rad=state.planned_gap_rad,
        calibrated=joints.reference.calibrated,
        resolver_error_rad=joints.resolver_error_rad,
    )
