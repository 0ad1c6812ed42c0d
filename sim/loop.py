"""Plant and avionics in a closed loop with flight software, or with recorded actuator commands.

In a closed loop a difference changes the next set-points and spreads to other joints.
With the same commands a difference stays in the joint and in the motion where it arises.
"""

from collections.abc import Iterable, Iterator
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from fsw.config import Config, configure
from fsw.cycle import step
from fsw.dictionary.commands import Command
from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import SoftwareError
from fsw.dictionary.types import Joints5
from fsw.estimate.reference import Reference
from fsw.kinematics.transforms import Array
from fsw.messages import ActuatorCommand, Outputs, Sensors
from fsw.state import State, boot, outputs_at_rest
from sim.arm_model.description import ArmDescription
from sim.arm_model.load import ArmModel, default_arm
from sim.arms import BuiltArm
from sim.avionics import Avionics
from sim.effects.effect import Effect, Hardware, apply_effects, check_effects, nominal_hardware
from sim.effects.faults import InjectedFault
from sim.plant import Plant
from sim.record import CycleRecord, Truth
from sim.setting import World
from sim.world import build, params_in_world


@dataclass(frozen=True, slots=True)
class Setup:
    """Definition of a run; the seed is that of everything random but the arm."""

    arm: BuiltArm
    world: World
    start_rad: Joints5
    seed: int = 0
    reference: Reference | None = None
    """Reference in the memory of flight software; None if no joint was homed."""
    effects: tuple[Effect, ...] = ()
    """Effects beyond those of the arm."""
    time_step_s: float | None = None
    """Time step in place of that of the model."""


class ClosedLoop:
    """Run of an arm in the closed loop; call `cycle` with the commands of each control cycle."""

    def __init__(self, setup: Setup, with_truth: bool = False):
        check_effects(setup.effects, setup.arm.params)
        self.setup = setup
        spec = build(setup.world, setup.arm.model)
        if setup.time_step_s is not None:
            spec.option.timestep = setup.time_step_s
        hardware = apply_effects(
            (*setup.arm.effects, *setup.effects), spec, nominal_hardware(setup.arm.model.description)
        )
        self.config: Config = configure(params_in_world(setup.world, setup.arm.params))
        self.plant = Plant(spec.compile())
        self.avionics = Avionics(self.plant, hardware, hardware_rng(setup.seed))
        self.with_truth = with_truth
        begin = self.avionics.act if hardware.each_cycle else None
        self.plant.place(np.array(setup.start_rad), begin=begin)
        stowed = setup.start_rad == setup.arm.params.poses.stowed_rad
        self.state: State = boot(self.config, Mode.STOWED if stowed else Mode.DEPLOYED, setup.reference)
        self.failure: Exception | None = None
        self._outputs = outputs_at_rest(self.state)
        self._truth: Truth | None = None

    def fork(self, faults: tuple[InjectedFault, ...] = ()) -> "ClosedLoop":
        """Copy the run, with equal bits from here on, or with faults injected into the copy.

        A fork that is never run is a snapshot.
        """
        other = copy(self)
        other.plant = self.plant.duplicate()
        other.avionics = self.avionics.for_plant(other.plant)
        for fault in faults:
            other.avionics.inject(fault)
        return other

    def cycle(self, commands: tuple[Command, ...] = ()) -> CycleRecord:
        """Run one control cycle: read the sensors, call flight software, and step the plant.

        Cycles in which flight software is not called are run first. RuntimeError says that it has ended.
        """
        if self.failure is not None:
            raise RuntimeError("flight software has ended; start another run") from self.failure
        for _ in range(self.avionics.missed_cycles()):
            self.avionics.sense()
            self._drive()
        sensors = self.avionics.sense()
        truth = self.truth() if self.with_truth else None
        tick = self.state.tick
        self.state, outputs, self.failure = step_flight_software(
            self.config, self.state, self._outputs, sensors, commands
        )
        self._outputs = outputs
        self._drive()
        while self.failure is not None and self.avionics.brakes_move:
            self._drive()
        return CycleRecord(tick, sensors, commands, outputs, truth)

    @property
    def braked(self) -> bool:
        """Return whether every brake is on and no motor has power."""
        brakes = self.plant.data.eq_active[self.plant.at.brake]
        return bool(brakes.all() and not self._outputs.drive.power_on.any())

    def truth(self) -> Truth:
        """Return the state of the plant, which is computed once between two steps."""
        if self._truth is None:
            self._truth = self.plant.truth()
        return self._truth

    def _drive(self) -> None:
        """Step the plant for a cycle with the last actuator command."""
        self._truth = None
        self.avionics.apply(self._outputs.drive)
        self.plant.step()


def hardware_rng(seed: int) -> np.random.Generator:
    """Make the generator of everything random in the avionics of a run."""
    return np.random.default_rng([seed, 2])


def step_flight_software(
    config: Config, state: State, last: Outputs, sensors: Sensors, commands: tuple[Command, ...]
) -> tuple[State, Outputs, Exception | None]:
    """Run one cycle of flight software; return state, outputs, and the exception that ended it, or None."""
    try:
        state, outputs = step(config, state, sensors, commands)
    except Exception as error:
        # only here is a software error caught: apply the brakes, report it, and end the run
        return state, _safe_outputs(last, error), error
    return state, outputs, None


def _safe_outputs(last: Outputs, error: Exception) -> Outputs:
    """Return the last outputs with brakes on, power off and an event for the exception."""
    off = np.zeros_like(last.drive.power_on)
    drive = replace(last.drive, setpoint_rate_rad_s=np.zeros(off.size), power_on=off, brake_release=off)
    joint = replace(last.joint, busy=False)
    evr = SoftwareError(f"{type(error).__name__}: {error}")
    return replace(last, drive=drive, joint=joint, tool=None, evrs=(evr,))


@dataclass(frozen=True, slots=True, eq=False)
class RecordedStart:
    """Start of a recorded run; joint arrays have shape (5,)."""

    world: World
    motor_rad: Array
    """Motor angles, from the encoders and the zeros below."""
    zero_rad: Array
    """Motor angles at which counters read 0, from homing."""
    hardstop_rad: Array
    """Hardstop angles that homing assumed."""
    arm: ArmModel = field(default_factory=default_arm)
    """Drawing of the arm."""


def scale_shift_rad(
    hardware: Hardware, counted_rad: Array, hardstop_rad: Array, arm: ArmDescription
) -> Array:
    """Compute by how much motors are beyond the angles that their counts mean to flight software.

    Homing finds the zero of an encoder at its hardstop, so that an error of its scale is 0 there.

    Args:
        hardware: Hardware with the true scale of the encoders.
        counted_rad: Angles by counts, zeros and nominal scale, joints first, shape (5,) or (5, n).
        hardstop_rad: Angles of the hardstops that homing assumed, shape (5,).

    Returns:
        Shifts [rad], in the shape of `counted_rad`.
    """
    error = hardware.rad_per_count / nominal_hardware(arm).rad_per_count - 1.0
    shift_rad: Array = (error * (counted_rad.T - hardstop_rad)).T
    return shift_rad


class OpenLoopArm:
    """Arm at the start of a recorded run.

    The seed is that of the sensor noise; None removes noise and rounding, which gives mean readings.
    """

    def __init__(self, start: RecordedStart, effects: Iterable[Effect], seed: int | None = None):
        spec, drawing = build(start.world, start.arm), start.arm.description
        effects = tuple(effects)
        built = apply_effects((one for one in effects if one.built_in), spec, nominal_hardware(drawing))
        # the recorded zeros are those after homing, wherever the counters started
        homed = replace(built, counter_zero_rad=start.zero_rad)
        hardware = apply_effects((one for one in effects if not one.built_in), spec, homed)
        self.plant = Plant(spec.compile())
        # an error of the assumed hardstop, or of the scale up to it, shifted the zero that homing found
        hardstop_error_rad = start.hardstop_rad - self.plant.stop_rad()
        zero_rad = hardware.counter_zero_rad - hardstop_error_rad
        by_scale_rad = scale_shift_rad(hardware, start.zero_rad, start.hardstop_rad, drawing)
        hardware = replace(hardware, counter_zero_rad=zero_rad + by_scale_rad)
        hardware = hardware if seed is not None else _without_noise(hardware)
        self.avionics = Avionics(self.plant, hardware, hardware_rng(seed or 0))
        # counters must read what they read in the recorded run, so the motors shift with zeros and scales
        self.plant.place(
            start.motor_rad
            + (zero_rad - start.zero_rad)
            + scale_shift_rad(hardware, start.motor_rad, start.hardstop_rad, drawing),
            begin=self.avionics.act if hardware.each_cycle else None,
        )

    def readings(self, drives: Iterable[ActuatorCommand]) -> Iterator[Sensors]:
        """Step the arm through actuator commands; PlantDiverged if MuJoCo counted a warning."""
        for drive in drives:
            yield self.avionics.sense()
            self.avionics.apply(drive)
            self.plant.step()


def _without_noise(hardware: Hardware) -> Hardware:
    return replace(
        hardware,
        resolver_noise_rad=0.0,
        resolver_step_rad=0.0,
        current_noise_A=0.0,
        gravity_noise_m_s2=0.0,
        structure_noise_K=0.0,
    )
