"""Preview of placements: a search for a branch and a path without collisions.

It uses what flight software knows: the nominal model of rover and terrain, not the built arm.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

import mujoco
import numpy as np

from fsw.config import Config, configure
from fsw.dictionary.commands import AUTO
from fsw.estimate.joints import JointEstimate, uninitialised_estimate
from fsw.estimate.reference import Reference, no_reference
from fsw.executive.planning import plan_command
from fsw.kinematics.branches import BRANCHES
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.statics import Equilibrium, settle
from fsw.kinematics.transforms import Array
from fsw.motion.compensation import Compensation
from fsw.motion.paths import Path
from fsw.motion.plan import Plan, Refusal, estimate_at, plan_poses
from fsw.motion.plan_tool import plan_tool
from sim.arms import BuiltArm
from sim.loop import ClosedLoop, Setup
from sim.placement import Placement, PlacementResult, PlacementRun, placement_moves
from sim.plant import Plant
from sim.workspace import random_surface
from sim.world import Surface, World, build, params_in_world

VIA_M: Final = 0.25
CLEARANCE_M: Final = 0.03
STOW_CLEARANCE_M: Final = 0.01
"""Clearance while unstowing: the stowed arm lies 15 mm beside its own shoulder."""
TOUCH_CLEARANCE_M: Final = 0.002
"""Clearance along the guarded line, where the tool is close to other parts of the scene."""
SPACING_RAD: Final = 0.02
SPACING_M: Final = 0.001
"""Spacing on a guarded line; less than its clearance."""


@dataclass(frozen=True, slots=True, eq=False)
class Preview:
    """Placement with a branch and a path without collisions, or with the reason for none."""

    placement: Placement
    problem: str | None
    duration_s: float
    """Upper bound from the ready pose to contact."""
    standoff_rad: Array
    """Motor angles at the standoff, shape (5,)."""


def preview_placement(arm: BuiltArm, world: World, placement: Placement, stowed: bool = False) -> Preview:
    """Find the first path without collisions from the ready pose to contact.

    Paths straight to the standoff are tried on every branch first, then paths from above.
    From the stowed pose, the path to the ready pose must be free too; it is the same for every branch.
    """
    config = configure(params_in_world(world, arm.params))
    spec = build(world, arm.model)
    for geom in spec.geoms:
        geom.margin = 0.5 * CLEARANCE_M
    plant = Plant(spec.compile())
    ready = np.array(arm.params.poses.ready_rad)
    joints = _joint_estimate(config, ready, world.gravity_N_m_s2)
    if stowed:
        hit = _unstow_collision(config, plant, joints)
        if hit is not None:
            return _infeasible(placement, f"{hit} on the way from the stowed to the ready pose")
    previews = []
    for via_m in (0.0, VIA_M):
        for branch in (AUTO, *BRANCHES):
            found = _check_branch(config, plant, joints, replace(placement, branch=branch, via_m=via_m))
            if found.problem is None:
                return found
            previews.append(found)
    return previews[0]


def unstow_duration_s(arm: BuiltArm) -> float:
    """Compute the duration of the move from the stowed to the ready pose."""
    config = configure(arm.params)
    plan = _plan_unstow(config, _joint_estimate(config, np.array(arm.params.poses.ready_rad), np.zeros(3)))
    return 0.0 if isinstance(plan, Refusal) else sum(path.duration_s for path in plan.paths)


def _plan_unstow(config: Config, joints: JointEstimate) -> Plan | Refusal:
    poses = config.params.poses
    way = [np.array(pose) for pose in (*poses.unstow_via_rad, poses.ready_rad)]
    stowed = replace(joints, motor_rad=np.array(poses.stowed_rad))
    return plan_poses(config, stowed, way, Compensation())


def _joint_estimate(config: Config, motor_rad: Array, gravity_R_m_s2: Array) -> JointEstimate:
    joints = uninitialised_estimate(config, no_reference(config))
    return replace(joints, motor_rad=motor_rad, imu_R_m_s2=gravity_R_m_s2)


def _unstow_collision(config: Config, plant: Plant, joints: JointEstimate) -> str | None:
    plan = _plan_unstow(config, joints)
    if isinstance(plan, Refusal):
        return plan.reason
    ways = (_path_poses(config, joints, path) for path in plan.paths)
    hits = (_first_collision(plant, way, STOW_CLEARANCE_M) for way in ways)
    return next((hit for hit in hits if hit is not None), None)


def _check_branch(config: Config, plant: Plant, joints: JointEstimate, placement: Placement) -> Preview:
    moves, touch = placement_moves(placement)
    duration = 0.0
    for move in moves:
        plan = plan_tool(config, joints, move)
        if isinstance(plan, Refusal):
            return _infeasible(placement, plan.reason)
        ways = [_path_poses(config, joints, path) for path in plan.paths]
        hit = next((hit for hit in (_first_collision(plant, way, CLEARANCE_M) for way in ways) if hit), None)
        if hit is not None:
            return _infeasible(placement, f"{plan.branch}: {hit} on the way to the standoff")
        duration += sum(path.duration_s for path in plan.paths)
        joints = estimate_at(joints, plan.end)
        placement = replace(placement, branch=plan.branch or AUTO)
    line = plan_command(config, joints, placement.tool, touch)
    if isinstance(line, Refusal):
        return _infeasible(placement, line.reason)
    hit = _first_collision(
        plant, _guarded_poses(config, joints, line, placement), TOUCH_CLEARANCE_M, placement.tool
    )
    if hit is not None:
        return _infeasible(placement, f"{placement.branch}: {hit} on the way from the standoff to the target")
    duration += sum(path.duration_s for path in line.paths)
    return Preview(placement, None, duration, joints.motor_rad)


def _infeasible(placement: Placement, problem: str) -> Preview:
    return Preview(placement, problem, 0.0, np.zeros(5))


def _path_poses(config: Config, joints: JointEstimate, path: Path) -> Equilibrium:
    start, end = path.at(0.0).motor_rad, path.at(path.duration_s).motor_rad
    samples = int(np.abs(end - start).max() / SPACING_RAD) + 2
    way = np.array([path.at(t).motor_rad for t in np.linspace(0, path.duration_s, samples)]).T
    return settle(config.arm, way, np.zeros_like(way), joints.gravity_R_m_s2)


def _guarded_poses(config: Config, joints: JointEstimate, line: Plan, placement: Placement) -> Equilibrium:
    """Settle the poses along a guarded line up to the target; the rest of the line is overtravel."""
    samples = round((placement.standoff_m + placement.overtravel_m) / SPACING_M)
    way = [path.at(t).motor_rad for path in line.paths for t in np.linspace(0, path.duration_s, samples)]
    motor, gap = np.array(way).T, line.backlash_rad[:, None]
    poses = settle(config.arm, motor, gap, joints.gravity_R_m_s2)
    _, touch = placement_moves(placement)
    from_end = tool_pose(config.arm, poses.frames, placement.tool).p - np.array(touch.end_p_RoTo_R_m)[:, None]
    before = -np.array(touch.approach_R) @ from_end >= placement.overtravel_m
    return settle(config.arm, motor[:, before], gap, joints.gravity_R_m_s2)


def _first_collision(
    plant: Plant, poses: Equilibrium, clearance_m: float, touching: str | None = None
) -> str | None:
    """Return the first two geoms that come too close at these poses, or None.

    The pads of the tool `touching` may touch the rock face.
    """
    model, data = plant.model, plant.data
    for output, strain in zip(poses.output_rad.T, np.moveaxis(poses.strain, -1, 0), strict=True):
        plant.show(output, strain)
        mujoco.mj_collision(model, data)
        for contact in data.contact:
            if contact.dist < clearance_m and not _is_intended(model, contact.geom, touching):
                return " meets ".join(_geom_name(model, geom) for geom in contact.geom)
    return None


def _is_intended(model: mujoco.MjModel, geoms: Iterable[int], touching: str | None) -> bool:
    """Return whether a tool touches the rock face with its pads."""
    names = {model.geom(geom).name: model.body(model.geom_bodyid[geom]).name for geom in geoms}
    if touching is None or "rock_face" not in names:
        return False
    return any(name.endswith("_pad") and body == touching.lower() for name, body in names.items())


def _geom_name(model: mujoco.MjModel, geom: int) -> str:
    """Return the name of a geom, or that of the part of the arm that carries it."""
    name: str = model.geom(geom).name or model.body(model.geom_bodyid[geom]).name
    return name


def random_placement(seed: int, arm: BuiltArm, tool: str, max_tilt_rad: float) -> tuple[World, Preview]:
    """Draw placements of random point, normal and tilt until the preview of one has a path.

    Args:
        seed: Seed of the draws.
        arm: Arm with its flight parameters.
        tool: str to place.
        max_tilt_rad: Largest tilt of the rover, in any direction.
    """
    rng = np.random.default_rng([seed, 3])
    while True:
        point, normal = random_surface(rng)
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
