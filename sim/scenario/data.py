"""A scenario: a world, an arm in it, what it is asked to do, what goes wrong, and what success means."""

from dataclasses import dataclass, replace
from typing import Literal

from fsw.dictionary.commands import Command
from fsw.dictionary.enums import Tool
from fsw.dictionary.types import Vector3
from sim.arms import BuiltArm
from sim.effects.effect import Effect
from sim.effects.environment import WARM_C
from sim.effects.faults import Fault
from sim.scenario.checks import Check
from sim.world import World

Start = Literal["stowed", "ready"]


@dataclass(frozen=True, slots=True)
class Taught:
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

    fault: Fault
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
    start: Start = "stowed"
    arm: str = "nominal"
    temperature_C: float = WARM_C
    taught: tuple[Taught, ...] = ()
    faults: tuple[Injection, ...] = ()
    effects: tuple[Effect, ...] = ()
    """What is not as the arm's name says."""

    def tilted(self, roll_rad: float, pitch_rad: float) -> "Scenario":
        """The same on a rover that stands otherwise; places in RNAV stay what they are."""
        return replace(self, world=replace(self.world, tilt_roll_rad=roll_rad, tilt_pitch_rad=pitch_rad))

    def fitted(self, arm: BuiltArm) -> BuiltArm:
        """The arm with those effects that it has when its joints look for their hardstops."""
        return arm.with_effects(self.effects)
