"""State of flight software: the record that a cycle leaves for the next, its first value, its channels."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from fsw.collision.geometry import TargetSurface
from fsw.config import Config
from fsw.dictionary.commands import Command
from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import Evr
from fsw.dictionary.types import cycle_record
from fsw.estimate.joints import JointEstimate, LoadEstimate, no_load, uninitialised_estimate
from fsw.estimate.reference import Reference, no_reference
from fsw.kinematics.transforms import Array
from fsw.messages import ActuatorCommand, JointChannels, Outputs
from fsw.motion.move import Move
from fsw.motion.preload import PreloadState
from fsw.motion.work import Work
from fsw.protect.monitors import MonitorState
from fsw.protect.readings import ReadingState
from fsw.protect.responses import StandingFault


@dataclass(frozen=True, slots=True)
class Hold:
    """Sequence step in which the arm waits on its brakes."""

    duration_s: float
    vibrate: bool


SequenceStep = Command | Hold


@dataclass(frozen=True, slots=True)
class Sequence:
    """Compound command and its remaining steps."""

    command: str
    remaining: tuple[SequenceStep, ...]


NO_READINGS: Final = ReadingState()


@cycle_record
class Planning:
    """Command that is being planned while the arm rests on its brakes."""

    command: SequenceStep
    rest_mode: Mode
    """Mode of the arm before and, after a refusal, again."""
    surface: TargetSurface | None
    """Surface that the command is to keep away from."""
    events: tuple[Evr, ...]
    """Events to report when the command begins, on what it was planned from."""
    start_rad: Array
    """Motor angles from which it is planned, (5,)."""
    work: Work[Any]
    """Work that is left."""


@cycle_record
class State:
    """Everything that a cycle leaves for the next one."""

    tick: int
    mode: Mode
    tool: str
    """Tool of the last tool command; the tool channels refer to it."""
    joints: JointEstimate
    load: LoadEstimate
    planned_backlash_rad: Array
    """Position of each output in its backlash that the set-points assume, (5,)."""
    planning: Planning | None
    """Command that is being planned; None if there is none."""
    move: Move | None
    """Move under way; None while the brakes hold the arm."""
    preload: PreloadState | None
    """Last preload of the tool in contact; None if it has moved since."""
    sequence: Sequence | None
    """Compound command under way; None if there is none."""
    fault: StandingFault | None
    monitors: MonitorState
    drive: ActuatorCommand
    structure_C: float = 0.0
    """Filtered temperature of the structure; without a meaning before the first usable reading."""
    structure_readings: int = 0
    """Number of usable readings in it."""
    surface: TargetSurface | None = None
    """Surface of the last target, from the last touch if there was one; None after an unstow."""
    changed_config: Config | None = None
    """Configuration with the present temperature and parameters; None if it is that at boot."""
    readings: ReadingState = NO_READINGS
    """Readings of the last cycles, by which the next ones are judged."""

    @property
    def is_busy(self) -> bool:
        """Return whether a command is under way."""
        return self.move is not None or self.sequence is not None or self.planning is not None

    @property
    def rest_mode(self) -> Mode:
        """Return the mode in which the arm is protected; a command that is being planned changes nothing."""
        return self.mode if self.planning is None else self.planning.rest_mode


def boot(config: Config, mode: Mode, reference: Reference | None = None) -> State:
    """Build the state before the first cycle, brakes on, power off; the reference is of an earlier homing."""
    config.prepare()
    n = config.rad_per_count.size
    off = np.zeros(n, bool)
    return State(
        tick=0,
        mode=mode,
        tool=config.params.tools[0].name,
        joints=uninitialised_estimate(config, no_reference(config) if reference is None else reference),
        load=no_load(n),
        planned_backlash_rad=np.zeros(n),
        planning=None,
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
    """Return the outputs of a cycle in which nothing changes: the last actuator command, present channels."""
    return Outputs(state.drive, joint_channels(state.tick, state, state.joints.backlash_state), None, ())


def last_setpoint(state: State) -> Array:
    """Return the last commanded motor angles in radians, shape (5,).

    They are the set-point of the move; without a move, the angles at which the brakes hold the motors.
    """
    return state.joints.motor_rad if state.move is None else state.move.setpoint.motor_rad


def joint_channels(tick: int, state: State, backlash_state: Array) -> JointChannels:
    """Return the joint channels of a cycle.

    Args:
        backlash_state: Rows of `JointEstimate.backlash_state`: angle, side, uncertainty; shape (3, 5).
    """
    joints = state.joints
    # positional arguments, because they are faster and this runs in every cycle
    return JointChannels(
        tick,
        state.mode,
        state.is_busy,
        joints.motor_rad,
        joints.motor_rate_rad_s,
        last_setpoint(state),
        joints.output_rad,
        backlash_state[0],
        backlash_state[1],
        backlash_state[2],
        state.planned_backlash_rad,
        joints.reference.calibrated,
        joints.resolver_error_rad,
    )
