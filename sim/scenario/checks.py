"""What success of a scenario means, as data. Commands are numbered from 1, in the order of the scenario.

A scenario file names a check as it names a command: OverInlet is OVER_INLET.
"""

from dataclasses import dataclass
from math import pi
from typing import Annotated, Final

from fsw.dictionary.enums import Tool
from fsw.dictionary.types import Limits, Vector3

Number = Annotated[int, Limits(1, 1000)]
"""Of a command."""
Share = Annotated[float, Limits(0.0, 1.0)]
Force = Annotated[float, Limits(0.0, 1000.0)]
Length = Annotated[float, Limits(0.0, 1.0)]
Angle = Annotated[float, Limits(0.0, 3.2)]

DEGREE: Final = pi / 180

SOME_N: Final = 1.0
"""Less than this is no contact: no switch would close."""


@dataclass(frozen=True, slots=True)
class Done:
    """Every command was carried out, without a refusal or a fault."""


@dataclass(frozen=True, slots=True)
class Placed:
    """At the end of a command a tool touches the surface next to its point."""

    after: Number
    tool: Tool
    lateral_m: Length = 0.015


@dataclass(frozen=True, slots=True)
class SameSpot:
    """A tool touches where another one touched, both as they truly were at the end of their commands."""

    after: Number
    tool: Tool
    first_after: Number
    first_tool: Tool
    lateral_m: Length = 0.010


@dataclass(frozen=True, slots=True)
class Preloaded:
    """At the end of a command a tool presses on the surface with a force, and on the way it does not slip."""

    after: Number
    tool: Tool
    force_N: Force
    share: Share = 0.10
    """How far the force may be off, as a share of it."""
    most_N: Force = 400.0
    """Of the normal force, from the beginning of the command on."""
    ratio: Annotated[float, Limits(0.0, 10.0)] = 0.35
    """Of lateral to normal force, from then on."""
    slip_m: Length = 1e-3
    """Of each contact pad along the surface, while it touches."""
    pressed_N: Force = 20.0
    """The normal force from which on ratio and slip count."""


@dataclass(frozen=True, slots=True)
class GravityHeld:
    """While a command vibrates, and at its end, true gravity lies along a direction of a tool."""

    during: Number
    tool: Tool
    gravity_T: Vector3
    """In the tool's true axes."""
    angle_rad: Angle = 1.0 * DEGREE


@dataclass(frozen=True, slots=True)
class OverInlet:
    """At the end of a command a tool is over a taught point, near the line upright to the deck through it."""

    after: Number
    point: str
    lateral_m: Length = 0.005
    angle_rad: Angle = 2.0 * DEGREE
    """Between the tool and gravity."""


@dataclass(frozen=True, slots=True)
class Docked:
    """At the end of a command a tool is at a taught point, looks the way it should, and touches."""

    after: Number
    point: str
    distance_m: Length = 0.003
    angle_rad: Angle = 1.5 * DEGREE


@dataclass(frozen=True, slots=True)
class Loaded:
    """At the end of a command the tool of a taught point presses with a force, along its approach."""

    after: Number
    point: str
    force_N: Force
    share: Share = 0.20


@dataclass(frozen=True, slots=True)
class Released:
    """At the end of the scenario a tool touches nothing."""

    tool: Tool


@dataclass(frozen=True, slots=True)
class Stowed:
    """The arm ends in its stowed pose and knows it."""

    angle_rad: Angle = 0.02
    """Of each true output."""


@dataclass(frozen=True, slots=True)
class Faulted:
    """A fault of this name ended the sequence: the arm is braked, and refuses if that is the response."""

    evr: str


@dataclass(frozen=True, slots=True)
class Recovered:
    """A fault of this name came, and the sequence went on after it to its end."""

    evr: str


Check = (
    Done
    | Placed
    | SameSpot
    | Preloaded
    | GravityHeld
    | OverInlet
    | Docked
    | Loaded
    | Released
    | Stowed
    | Faulted
    | Recovered
)
