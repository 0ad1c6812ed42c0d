"""How fast a motor is, for effects that look once a cycle.

A set-point that is held for a cycle makes the motor surge and slacken within it: its speed at one moment of
the cycle, always the same, is not the speed that it goes with.
"""

from dataclasses import dataclass

from fsw.dictionary.enums import Joint
from sim.plant import Plant


@dataclass(frozen=True, slots=True)
class Pace:
    """Where a motor was when it was looked at last."""

    time_s: float
    angle_rad: float


def pace_now(plant: Plant, joint: Joint) -> Pace:
    """Where it is."""
    return Pace(float(plant.data.time), float(plant.motor_rad()[joint]))


def speed_rad_s(before: Pace, now: Pace) -> float:
    """Its mean speed in between, output side; 0 where no time has passed."""
    elapsed_s = now.time_s - before.time_s
    return (now.angle_rad - before.angle_rad) / elapsed_s if elapsed_s > 0 else 0.0
