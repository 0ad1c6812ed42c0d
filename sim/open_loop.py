"""Plant and avionics that follow recorded actuator commands, without flight software.

In a closed loop a difference changes the next set-points and spreads to other joints.
With the same commands a difference stays in the joint and in the motion where it arises.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from fsw.kinematics.transforms import Array
from fsw.messages import ActuatorCommand, Sensors
from sim.avionics import Avionics
from sim.effects.effect import Effect, Hardware, apply_effects, nominal_hardware
from sim.loop import SETTLE_S, hardware_rng
from sim.plant import Plant
from sim.world import World, build


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


@dataclass(frozen=True, slots=True)
class SimulationOptions:
    """Options of a simulation."""

    seed: int | None = None
    """Seed of the sensor noise; None removes noise and rounding, which gives mean readings."""
    settle_s: float = SETTLE_S


NOISE_FREE = SimulationOptions()


def scale_shift_rad(hardware: Hardware, counted_rad: Array, hardstop_rad: Array) -> Array:
    """Compute by how much motors are beyond the angles that their counts mean to flight software.

    Homing finds the zero of an encoder at its hardstop, so that an error of its scale is 0 there.

    Args:
        hardware: Hardware with the true scale of the encoders.
        counted_rad: Angles by counts, zeros and nominal scale, joints first, shape (5,) or (5, n).
        hardstop_rad: Angles of the hardstops that homing assumed, shape (5,).

    Returns:
        Shifts [rad], in the shape of `counted_rad`.
    """
    error = hardware.rad_per_count / nominal_hardware().rad_per_count - 1.0
    shift_rad: Array = (error * (counted_rad.T - hardstop_rad)).T
    return shift_rad


class OpenLoopArm:
    """Arm at the start of a recorded run."""

    def __init__(
        self, start: RecordedStart, effects: Iterable[Effect], options: SimulationOptions = NOISE_FREE
    ):
        spec = build(start.world)
        effects = tuple(effects)
        built = apply_effects((one for one in effects if one.built_in), spec, nominal_hardware())
        # the recorded zeros are those after homing, wherever the counters started
        homed = replace(built, counter_zero_rad=start.zero_rad)
        hardware = apply_effects((one for one in effects if not one.built_in), spec, homed)
        self.plant = Plant(spec.compile())
        # an error of the assumed hardstop, or of the scale up to it, shifted the zero that homing found
        hardstop_error_rad = start.hardstop_rad - self.plant.stop_rad()
        zero_rad = hardware.counter_zero_rad - hardstop_error_rad
        by_scale_rad = scale_shift_rad(hardware, start.zero_rad, start.hardstop_rad)
        hardware = replace(hardware, counter_zero_rad=zero_rad + by_scale_rad)
        hardware = hardware if options.seed is not None else _without_noise(hardware)
        self.avionics = Avionics(self.plant, hardware, hardware_rng(options.seed or 0))
        # counters must read what they read in the recorded run, so the motors shift with zeros and scales
        self.plant.place(
            start.motor_rad
            + (zero_rad - start.zero_rad)
            + scale_shift_rad(hardware, start.motor_rad, start.hardstop_rad),
            options.settle_s,
            self.avionics.act if hardware.each_cycle else None,
        )

    def readings(self, drives: Iterable[ActuatorCommand]) -> Iterator[Sensors]:
        """Step the arm through actuator commands.

        Yields:
            The readings before each command.

        Raises:
            PlantDiverged: MuJoCo counted a warning.
        """
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
