"""Preview of placements: what flight software plans from the ready pose, without a run.

It uses what flight software knows: the nominal model of rover and terrain, not the built arm.
"""

from dataclasses import dataclass, replace

import numpy as np

from fsw.config import Config, configure
from fsw.dictionary.commands import Unstow
from fsw.dictionary.validity import Wrong, read_arguments
from fsw.estimate.joints import JointEstimate, uninitialised_estimate
from fsw.estimate.reference import Reference, no_reference
from fsw.executive.context import known_names
from fsw.executive.expansion import locate_surface
from fsw.executive.planning import plan_command, plan_sequence
from fsw.kinematics.transforms import Array
from fsw.motion.plan import JointPositions, Plan, Refusal, estimate_at
from sim.arms import BuiltArm
from sim.loop import ClosedLoop, Setup
from sim.placement import Placement, PlacementResult, PlacementRun, place_command
from sim.workspace import random_surface
from sim.world import Surface, World, params_in_world


@dataclass(frozen=True, slots=True, eq=False)
class Preview:
    """Placement as flight software plans it, or the reason that it refuses."""

    placement: Placement
    problem: str | None
    plans: tuple[Plan, ...] = ()
    """Plans of the moves to the standoff, and of the guarded move; none with a problem."""

    @property
    def duration_s(self) -> float:
        """Return an upper bound of the duration from the ready pose to contact."""
        return sum(path.duration_s for plan in self.plans for path in plan.paths)

    @property
    def branch(self) -> str | None:
        """Return the branch of the inverse kinematics at the standoff."""
        return self.plans[-2].branch if self.plans else None

    @property
    def standoff_rad(self) -> Array:
        """Return the motor angles at the standoff, shape (5,)."""
        return self.plans[-2].end.motor_rad


def preview_placement(arm: BuiltArm, world: World, placement: Placement, stowed: bool = False) -> Preview:
    """Plan a placement from the ready pose; from the stowed pose, the way to the ready pose too."""
    config = configure(params_in_world(world, arm.params))
    command = read_arguments(place_command(placement), known_names(config.params))
    if isinstance(command, Wrong):
        return Preview(placement, command.text)
    joints = first_estimate(config, np.array(arm.params.poses.ready_rad), world.gravity_N_m_s2)
    if stowed:
        unstow = _plan_unstow(config, joints)
        if isinstance(unstow, Refusal):
            return Preview(placement, f"{unstow.reason} on the way from the stowed to the ready pose")
    surface = locate_surface(config, joints, command.tool, command, None)
    planned = plan_sequence(config, joints, command.tool, command, surface)
    if isinstance(planned, Refusal):
        return Preview(placement, planned.reason)
    return Preview(placement, None, planned.plans)


def unstow_duration_s(arm: BuiltArm) -> float:
    """Compute the duration of the move from the stowed to the ready pose."""
    config = configure(arm.params)
    plan = _plan_unstow(config, first_estimate(config, np.array(arm.params.poses.ready_rad), np.zeros(3)))
    return 0.0 if isinstance(plan, Refusal) else sum(path.duration_s for path in plan.paths)


def _plan_unstow(config: Config, joints: JointEstimate) -> Plan | Refusal:
    stowed = joints_at(joints, np.array(config.params.poses.stowed_rad))
    return plan_command(config, stowed, config.params.tools[0].name, Unstow(), None)


def first_estimate(config: Config, output_rad: Array, gravity_R_m_s2: Array) -> JointEstimate:
    """Build the estimate of calibrated joints at rest at these outputs, with gravity from the IMU."""
    joints = uninitialised_estimate(config, no_reference(config))
    return joints_at(replace(joints, imu_R_m_s2=gravity_R_m_s2), output_rad)


def joints_at(joints: JointEstimate, output_rad: Array) -> JointEstimate:
    """Return the estimate with each output at an angle, in the middle of its backlash."""
    return estimate_at(joints, JointPositions(output_rad, np.zeros_like(output_rad)))


def random_placement(seed: int, arm: BuiltArm, tool: str, max_tilt_rad: float) -> tuple[World, Preview]:
    """Draw placements of random point, normal and tilt until flight software plans one.

    Args:
        max_tilt_rad: Largest tilt of the rover, in any direction.
    """
    rng = np.random.default_rng([seed, 3])
    while True:
        point, normal = random_surface(rng, arm.model.workspace)
        tilt, heading = rng.uniform(0.0, max_tilt_rad), rng.uniform(-np.pi, np.pi)
        roll, pitch = float(tilt * np.cos(heading)), float(tilt * np.sin(heading))
        world = World("mars", roll, pitch, Surface(point, normal))
        preview = preview_placement(arm, world, Placement(tool, point, normal))
        if preview.problem is None:
            return world, preview


def run_placement(
    arm: BuiltArm, reference: Reference, world: World, placement: Placement, seed: int
) -> PlacementResult:
    """Run a placement in the closed loop, from the ready pose."""
    loop = ClosedLoop(Setup(arm, world, arm.params.poses.ready_rad, seed, reference))
    run = PlacementRun(loop, placement)
    for _ in run:
        pass
    return run.result()
