"""A plant with its avionics that is given a recorded drive, cycle by cycle, in place of flight software.

In a closed loop whatever differs is passed on to the next set-points and to other joints. Under the same
drive a difference stays in the joint and in the motion that it comes from.
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
    """Where a recorded run began; joint arrays (5,)."""

    world: World
    motor_rad: Array
    """By encoders and the zeros below."""
    zero_rad: Array
    """Motor angles at which counters read 0, as the hardstops told."""
    hardstop_rad: Array
    """Where the hardstops were taken to be when they told it."""


@dataclass(frozen=True, slots=True)
class SimulationOptions:
    """How a run is simulated."""

    seed: int | None = None
    """Of sensor noise; None leaves out noise and rounding, which gives what sensors read on average."""
    settle_s: float = SETTLE_S


NOISE_FREE = SimulationOptions()


class OpenLoopArm:
    """An arm at its start, about to be driven."""

    def __init__(
        self, start: RecordedStart, effects: Iterable[Effect], manner: SimulationOptions = NOISE_FREE
    ):
        spec = build(start.world)
        hardware = apply_effects(effects, spec, replace(nominal_hardware(), counter_zero_rad=start.zero_rad))
        self.plant = Plant(spec.compile())
        # a hardstop that is not where it was taken to be has shifted the zero that was found there
        off_rad = start.hardstop_rad - self.plant.stop_rad()
        hardware = replace(hardware, counter_zero_rad=hardware.counter_zero_rad - off_rad)
        hardware = hardware if manner.seed is not None else _without_noise(hardware)
        self.avionics = Avionics(self.plant, hardware, hardware_rng(manner.seed or 0))
        # the motors stand where these counters read what was read, whatever shifted their zeros
        self.plant.place(
            start.motor_rad + (hardware.counter_zero_rad - start.zero_rad),
            manner.settle_s,
            self.avionics.act if hardware.each_cycle else None,
        )

    def readings(self, drives: Iterable[ActuatorCommand]) -> Iterator[Sensors]:
        """What the sensors read before each drive is taken.

        Raises:
            PlantDiverged: MuJoCo counted a warning.
        """
        for drive in drives:
            yield self.avionics.sense()
            self.avionics.apply(drive)
            self.plant.step()


def _without_noise(hardware: Hardware) -> Hardware:
    return replace(
        hardware, resolver_noise_rad=0.0, resolver_step_rad=0.0, current_noise_A=0.0, gravity_noise_m_s2=0.0
    )
