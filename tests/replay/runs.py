"""Reference runs: short command sequences, each with its own arm and world."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fsw.dictionary import commands
from fsw.dictionary.enums import Joint
from fsw.dictionary.types import joints5
from sim.arms import BuiltArm, arm_named
from sim.effects.effect import Effect
from sim.effects.faults import MissedCycles, SensorFault
from sim.loop import ClosedLoop, Setup
from sim.record import CycleRecord
from sim.setting import Surface, World
from tests.sim.lab import true_reference

LEVEL = World()
LONG = 4000
"""Cycles in which every command of a run completes."""
REST = 8

ROCK = Surface((2.05, 0.1, -0.25), (-0.50443327, 0.10088665, -0.85753656))
IN = (0.50443327, -0.10088665, 0.85753656)
FRONT_OF_ROCK = (1.9539268, 0.10121064, 0.86020956)
"""Point 12 mm in front of the face of the rock, RMECH."""
APXS_THERE = (29.631, -12.689, 120.225, -42.279, 113.491)
APXS_ROCK = Surface((2.046, 0.1008, -0.2568), ROCK.normal_N)
"""Rock closer by 8 mm, which is the deflection of the arm under its weight."""
NEAR_ROCK = Surface((2.044, 0.1012, -0.2602), ROCK.normal_N)
"""Rock closer by another 4 mm, for an arm that is deflected less."""
TURRET_AT_ITS_STOP = (-87.7, -153.4, -157.8, -184.2, -21.627)
DRILL_THERE = (31.006, -51.53, 114.065, 183.206, 200.107)


def beyond(distance_m: float) -> tuple[float, float, float]:
    """Return a point at a distance from FRONT_OF_ROCK towards the rock."""
    x, y, z = np.array(FRONT_OF_ROCK) + distance_m * np.array(IN)
    return (float(x), float(y), float(z))


@dataclass(frozen=True, slots=True)
class ReferenceRun:
    """Reference run."""

    name: str
    start_deg: tuple[float, ...] | None
    """Start pose; None for the ready pose."""
    asks: tuple[tuple[commands.Command, int], ...]
    """Commands, each with the number of cycles after which the next one is sent at the latest."""
    ends_with: str
    """Name of the event that shows that the run has reached its purpose."""
    arm: str = "nominal"
    world: World = LEVEL
    known: bool = True
    """True if the joints have found their hardstops."""
    effects: tuple[Effect, ...] = ()
    seed: int = 0

    def loop(self) -> ClosedLoop:
        """Make the closed loop of the run, before its first cycle."""
        arm: BuiltArm = arm_named(self.arm)
        start = arm.params.poses.ready_rad
        if self.start_deg is not None:
            start = joints5(np.radians(self.start_deg))
        reference = true_reference(arm) if self.known else None
        return ClosedLoop(Setup(arm, self.world, start, self.seed, reference, self.effects))

    def cycles(self, loop: ClosedLoop) -> Iterator[CycleRecord]:
        """Carry out the commands cycle by cycle, and a few cycles at rest."""
        for command, most in self.asks:
            for k in range(most):
                record = loop.cycle((command,) if k == 0 else ())
                yield record
                if not record.outputs.joint.busy:
                    break
        for _ in range(REST):
            yield loop.cycle()


RUNS = (
    ReferenceRun(
        "joints",
        None,
        (
            (commands.MoveJoint(Joint.TURRET, np.radians(90.7).item()), LONG),
            (commands.MoveJoints((0.1, 0.0, -0.1, 0.0, 0.2), backlash="off", relative=True), 60),
            (commands.Stop(), LONG),
        ),
        "CommandCompleted",
        arm="as-built:3",
    ),
    ReferenceRun(
        "contact",
        APXS_THERE,
        ((commands.GuardedMove("apxs", beyond(0.04), IN), LONG),),
        "ContactMade",
        arm="calibrated:7",
        world=World(surface=NEAR_ROCK),
    ),
    ReferenceRun(
        "press",
        DRILL_THERE,
        ((commands.GuardedMove("drill", beyond(0.06), IN), LONG), (commands.Preload("drill", 24.0), LONG)),
        "Preloaded",
        world=World(surface=APXS_ROCK),
    ),
    ReferenceRun(
        "tool-change",
        APXS_THERE,
        (
            (commands.GuardedMove("apxs", beyond(0.04), IN), LONG),
            (commands.ToolChange("drt", standoff_m=0.02, overtravel_m=0.01), 110),
            (commands.Stop(), LONG),
        ),
        "SpotSet",
        world=World("mars", 0.1, -0.05, APXS_ROCK),
    ),
    ReferenceRun(
        "hardstop",
        TURRET_AT_ITS_STOP,
        (
            (commands.SetParam("hardstop.retreat_rad", 0.006), LONG),
            (commands.SetParam("hardstop.fine_speed_rad_s", 0.002), LONG),
            (commands.Calibrate(Joint.TURRET), LONG),
        ),
        "JointCalibrated",
        arm="as-built:5",
        known=False,
    ),
    ReferenceRun(
        "fault",
        None,
        (
            (commands.MoveJoints((0.05, 0.0, -0.05, 0.0, 0.1), relative=True), LONG),
            (commands.MoveJoint(Joint.TURRET, 1.6), LONG),
            (commands.ClearFault(), LONG),
            (commands.MoveJoint(Joint.WRIST, 2.25), LONG),
        ),
        "FaultCleared",
        effects=(SensorFault(1.0, "resolver_rad", "biased", int(Joint.ELBOW), 0.02), MissedCycles(0.5, 2)),
    ),
    ReferenceRun(
        "no-number",
        None,
        ((commands.MoveJoints((0.05, 0.0, -0.05, 0.0, 0.1), relative=True), LONG),),
        "FaultResponse",
        effects=(SensorFault(1.0, "current_A", "nan", int(Joint.WRIST)),),
    ),
    ReferenceRun(
        "refused",
        None,
        (
            (commands.MoveJoint(Joint.TURRET, 7.0), LONG),
            (commands.MoveJoints((float("nan"), 0.0, 0.0, 0.0, 0.0)), LONG),
            (commands.MoveTool("apxs", (9.0, 0.0, 0.0), (0.0, 0.0, 1.0)), LONG),
            (commands.MoveTool("apxs", (1.5, 0.0, 0.5), (0.0, 0.0, 1.0), branch="upside-down"), LONG),
            (commands.PlaceTool("drill", (0.1, 0.0, -2.0), (0.0, 0.0, 1.0)), LONG),
            (commands.Preload("drill", 100.0), LONG),
            (commands.MoveTeachPoint("nowhere"), LONG),
            (commands.Retract("apxs", float("inf")), LONG),
            (commands.SetParam("joints.turret.speed", 1.0), LONG),
            (commands.SetParam("joints.turret.speed_rad_s", 9.0), LONG),
            (commands.SetTilt(1.0, 0.0), LONG),
            (commands.Unstow(), LONG),
            (commands.ToolChange("apxs"), LONG),
            (commands.Stow(), 40),
            (commands.MoveJoint(Joint.WRIST, 2.0), 1),
            (commands.SetParam("motion.load_period_cycles", 8.0), 1),
            (commands.Stop(), LONG),
        ),
        "CommandRefused",
    ),
    ReferenceRun(
        "settings",
        None,
        (
            (commands.SetParam("joints.wrist.speed_rad_s", 0.02), LONG),
            (commands.SetTilt(0.02, -0.03), LONG),
            (commands.Process("portion", (1.0, 0.3, 0.0), 0.5), 60),
            (commands.Stop(), LONG),
        ),
        "ParamSet",
        world=World("mars", 0.02, -0.03),
    ),
)
