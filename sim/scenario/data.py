"""Scenario as data: world, arm, commands, faults, and the checks that define success.

Commands are numbered from 1, in the order of the scenario.
A scenario file has the names of checks in lower case: OverInlet is over_inlet.
"""

from dataclasses import dataclass, replace
from math import pi
from typing import Annotated, Final, Literal

from fsw.dictionary.commands import Command
from fsw.dictionary.types import AUTO, Direction, Limits, Position, ToolName
from sim.arms import BuiltArm
from sim.effects.effect import Effect, check_effects
from sim.effects.faults import InjectedFault
from sim.setting import WARM_C, World

CommandNumber = Annotated[int, Limits(1, 1000)]
"""Number of a command in its scenario."""
Share = Annotated[float, Limits(0.0, 1.0)]
CheckForce = Annotated[float, Limits(0.0, 1000.0)]
CheckLength = Annotated[float, Limits(0.0, 1.0)]
CheckAngle = Annotated[float, Limits(0.0, 3.2)]

DEGREE: Final = pi / 180

CONTACT_THRESHOLD_N: Final = 1.0
"""Force below which there is no contact, as no switch would close."""


@dataclass(frozen=True, slots=True)
class Done:
    """Check that every command was completed, without a refusal or a fault."""


@dataclass(frozen=True, slots=True)
class Placed:
    """Check that a tool touches the surface next to its point at the end of a command."""

    after: CommandNumber
    tool: ToolName
    lateral_m: CheckLength = 0.015


@dataclass(frozen=True, slots=True)
class SameSpot:
    """Check that a tool touches the point that another one touched, by their true positions."""

    after: CommandNumber
    tool: ToolName
    first_after: CommandNumber
    first_tool: ToolName
    lateral_m: CheckLength = 0.010


@dataclass(frozen=True, slots=True)
class Preloaded:
    """Check that a tool presses with a force at the end of a command, and did not slip before."""

    after: CommandNumber
    tool: ToolName
    force_N: CheckForce
    share: Share = 0.10
    """Tolerance of the force, as a fraction of it."""
    max_N: CheckForce = 400.0
    """Limit of the normal force, from the start of the command on."""
    ratio: Annotated[float, Limits(0.0, 10.0)] = 0.35
    """Limit of the ratio of lateral to normal force, from the start of the command on."""
    slip_m: CheckLength = 1e-3
    """Limit of the slip of each contact pad along the surface, while it touches."""
    pressed_N: CheckForce = 20.0
    """Normal force above which ratio and slip are checked."""


@dataclass(frozen=True, slots=True)
class GravityHeld:
    """Check that true gravity is along a direction of a tool during vibration and at the end of a command."""

    during: CommandNumber
    tool: ToolName
    gravity_T: Direction
    """Direction in the true axes of the tool."""
    angle_rad: CheckAngle = 1.0 * DEGREE


@dataclass(frozen=True, slots=True)
class OverInlet:
    """Check that a tool is near the line through a taught point upright to the deck, after a command."""

    after: CommandNumber
    point: str
    lateral_m: CheckLength = 0.005
    angle_rad: CheckAngle = 2.0 * DEGREE
    """Limit of the angle between tool and gravity."""


@dataclass(frozen=True, slots=True)
class Docked:
    """Check that a tool has the pose of a taught point and touches, after a command."""

    after: CommandNumber
    point: str
    distance_m: CheckLength = 0.003
    angle_rad: CheckAngle = 1.5 * DEGREE


@dataclass(frozen=True, slots=True)
class Loaded:
    """Check that the tool of a taught point presses with a force along its approach, after a command."""

    after: CommandNumber
    point: str
    force_N: CheckForce
    share: Share = 0.20


@dataclass(frozen=True, slots=True)
class Released:
    """Check that a tool touches nothing at the end of the scenario."""

    tool: ToolName


@dataclass(frozen=True, slots=True)
class Stowed:
    """Check that the arm ends in its stowed pose, and in the mode of it."""

    angle_rad: CheckAngle = 0.02
    """Limit of the error of each true output angle."""


@dataclass(frozen=True, slots=True)
class Faulted:
    """Check that a fault ended the sequence: the arm is braked, and refuses moves if that is the response."""

    evr: str


@dataclass(frozen=True, slots=True)
class Recovered:
    """Check that a fault happened, and that the sequence was completed after it."""

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
    """Pose of a tool, by its true tip and boresight, that the arm is taught before a scenario."""

    name: str
    tool: ToolName
    p_N_m: Position
    """Position in RNAV."""
    approach_N: Direction
    branch: str = AUTO


@dataclass(frozen=True, slots=True)
class Injection:
    """Fault of the hardware, and its time."""

    fault: InjectedFault
    """Fault with its time, which counts from the start of the command `during` or of the scenario."""
    during: int | None = None
    """Number of a command, from 1; None if the time counts from the start of the scenario."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """Run without the seed of its arm."""

    name: str
    title: str
    summary: str
    world: World
    commands: tuple[Command, ...]
    checks: tuple[Check, ...]
    start: StartPose = "stowed"
    arm: str = "nominal"
    temperature_C: float = WARM_C
    taught: tuple[TaughtPoint, ...] = ()
    faults: tuple[Injection, ...] = ()
    effects: tuple[Effect, ...] = ()
    """Effects beyond those of the named arm."""

    def tilted(self, roll_rad: float, pitch_rad: float) -> "Scenario":
        """Return the scenario with another attitude of the rover; positions in RNAV stay."""
        return replace(self, world=replace(self.world, tilt_roll_rad=roll_rad, tilt_pitch_rad=pitch_rad))

    def fit_arm(self, arm: BuiltArm) -> BuiltArm:
        """Return the arm with effects that it has before the run; EffectMisfit if it lacks a place."""
        check_effects((injection.fault for injection in self.faults), arm.params)
        return arm.with_effects(self.effects)
