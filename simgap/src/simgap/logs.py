"""Logs: signals at their own rate, grouped by joint and by motion."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from simgap.arrays import Array, Flags

Usable = Mapping[tuple[str, str], Flags]
"""By names of motion and joint, which position samples take part, (n,); all where it has no entry."""


@dataclass(frozen=True, slots=True)
class Signal:
    """Samples of one quantity with their own times."""

    time_s: Array
    """Times of the samples, (n,), increasing; the zero is that of the motion."""
    value: Array
    """Values, (n,), in SI units."""


@dataclass(frozen=True, slots=True)
class JointLog:
    """Signals of one joint. Those that the robot file does not name are None."""

    position: Signal
    """[rad]."""
    command: Signal | None = None
    """In the unit of the control mode: rad, rad/s, N m at the joint, or A."""
    velocity: Signal | None = None
    """[rad/s]."""
    torque: Signal | None = None
    """[N m], at the joint."""
    current: Signal | None = None
    """[A]."""
    voltage: Signal | None = None
    """[V]."""
    temperature: Signal | None = None
    """[degC]."""
    secondary: Signal | None = None
    """Position of a second encoder, at the output [rad]."""
    enabled: Signal | None = None
    """1 while the motor has torque, else 0."""


@dataclass(frozen=True, slots=True)
class Motion:
    """One motion: the unit of inference."""

    name: str
    joints: Mapping[str, JointLog]
    gain: Mapping[str, float]
    """Joint name -> value of its gain column; 1 where there is none."""
    repeat_of: str = ""
    """Motions with the same text repeat one another; empty: never repeated."""
    conditions: Mapping[str, float] = field(default_factory=dict)
    """Condition of the robot file -> its value."""
    unwrapped: Mapping[str, int] = field(default_factory=dict)
    """Joint -> how often its counter began anew, so that turns were added when it was read."""
    start_s: float = 0.0
    """Its zero of time, since the start of the log [s]: there, windows of a robot file count."""


@dataclass(frozen=True, slots=True)
class Logs:
    """Motions of a robot, split by its split file."""

    motions: tuple[Motion, ...]
    held_out: frozenset[str] = frozenset()
    """Names of motions that take no part in a fit."""
    losses: tuple[str, ...] = ()
    """Sentences about what the files lack: a cut end, a signal that never is a number, motions in no part."""

    @property
    def fit(self) -> tuple[Motion, ...]:
        """Motions that are fitted."""
        return tuple(motion for motion in self.motions if motion.name not in self.held_out)

    @property
    def judged(self) -> tuple[Motion, ...]:
        """Motions that only judge."""
        return tuple(motion for motion in self.motions if motion.name in self.held_out)
