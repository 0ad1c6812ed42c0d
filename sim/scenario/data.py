"""A scenario as data: world, arm, commands, faults, and the checks that define success.

Commands are numbered from 1, in the order of the scenario. A scenario file names a check in lower case:
OverInlet is over_inlet.
"""

from dataclasses import dataclass, replace
from math import pi
from typing import Annotated, Final, Literal

from fsw.dictionary.commands import Command
from fsw.dictionary.enums import Tool
from fsw.dictionary.types import Limits, Vector3
from sim.arms import BuiltArm
from sim.effects.effect import Effect
from sim.effects.environment import WARM_C
from sim.effects.faults import InjectedFault
from sim.world import World

CommandNumber = Annotated[int, Limits(1, 1000)]
"""Of a command."""
Share = Annotated[float, Limits(0.0, 1.0)]
CheckForce = Annotated[float, Limits(0.0, 1000.0)]
CheckLength = Annotated[float, Limits(0.0, 1.0)]
CheckAngle = Annotated[float, Limits(0.0, 3.2)]

DEGREE: Final = pi / 180

CONTACT_THRESHOLD_N: Final = 1.0
"""Less than this is no contact: no switch would close."""


@dataclass(frozen=True, slots=True)
class Done:
    """Every command was carried out, without a refusal or a fault."""


@dataclass(frozen=True, slots=True)
class Placed:
    """At the end of a command a tool touches the surface next to its point."""

    after: CommandNumber
    tool: Tool
    lateral_m: CheckLength = 0.015


@dataclass(frozen=True, slots=True)
class SameSpot:
    """A tool touches where another one touched, both as they truly were at the end of their commands."""

    after: CommandNumber
    tool: Tool
    first_after: CommandNumber
    first_tool: Tool
    lateral_m: CheckLength = 0.010


@dataclass(frozen=True, slots=True)
class Preloaded:
    """At the end of a command a tool presses on the surface with a force, and on the way it does not slip."""

    after: CommandNumber
    tool: Tool
    force_N: CheckForce
    share: Share = 0.10
    """How far the force may be off, as a share of it."""
    most_N: CheckForce = 400.0
    """Of the normal force, from the beginning of the command on."""
    ratio: Annotated[float, Limits(0.0, 10.0)] = 0.35
    """Of lateral to normal force, from then on."""
    slip_m: CheckLength = 1e-3
    """Of each contact pad along the surface, while it touches."""
    pressed_N: CheckForce = 20.0
    """The normal force from which on ratio and slip count."""


@dataclass(frozen=True, slots=True)
class GravityHeld:
    """While a command vibrates, and at its end, true gravity lies along a direction of a tool."""

    during: CommandNumber
    tool: Tool
    gravity_T: Vector3
    """In the tool's true axes."""
    angle_rad: CheckAngle = 1.0 * DEGREE


@dataclass(frozen=True, slots=True)
class OverInlet:
    """At the end of a command a tool is over a taught point, near the line upright to the deck through it."""

    after: CommandNumber
    point: str
    lateral_m: CheckLength = 0.005
    angle_rad: CheckAngle = 2.0 * DEGREE
    """Between the tool and gravity."""


@dataclass(frozen=True, slots=True)
class Docked:
    """At the end of a command a tool is at a taught point, looks the way it should, and touches."""

    after: CommandNumber
    point: str
    distance_m: CheckLength = 0.003
    angle_rad: CheckAngle = 1.5 * DEGREE


@dataclass(frozen=True, slots=True)
class Loaded:
    """At the end of a command the tool of a taught point presses with a force, along its approach."""

    after: CommandNumber
    point: str
    force_N: CheckForce
    share: Share = 0.20


@dataclass(frozen=True, slots=True)
class Released:
    """At the end of the scenario a tool touches nothing."""

    tool: Tool


@dataclass(frozen=True, slots=True)
class Stowed:
    """The arm ends in its stowed pose and knows it."""

    angle_rad: CheckAngle = 0.02
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


StartPose = Literal["stowed", "ready"]


@dataclass(frozen=True, slots=True)
class TaughtPoint:
    """A place that a tool is taught before a scenario begins: where its true tip and boresight are to be."""

    name: str
    tool: Tool
    p_N_m: Vector3
    """RNAV."""
    approach_N: Vector3
    branch: str = "AUTO"


@dataclass(frozen=True, slots=True)
class Injection:
    """A fault of the hardware and when it comes."""

    fault: InjectedFault
    """With the time at which it comes; during a command, since that command began."""
    during: int | None = None
    """The number of that command, from 1; None for a time since the scenario began."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """Everything that a run needs but the arm's seed."""

    name: str
    title: str
    sentence: str
    world: World
    commands: tuple[Command, ...]
    checks: tuple[Check, ...]
    start: StartPose = "stowed"
    arm: str = "nominal"
    temperature_C: float = WARM_C
    taught: tuple[TaughtPoint, ...] = ()
    faults: tuple[Injection, ...] = ()
    effects: tuple[Effect, ...] = ()
    """What is not as the arm's name says."""

    def tilted(self, roll_rad: float, pitch_rad: float) -> "Scenario":
        """The same on a rover that stands otherwise; places in RNAV stay what they are."""
        return replace(self, world=replace(self.world, tilt_roll_rad=roll_rad, tilt_pitch_rad=pitch_rad))

    def fit_arm(self, arm: BuiltArm) -> BuiltArm:
        """The arm with those effects that it has when its joints look for their hardstops."""
        return arm.with_effects(self.effects)
