"""Looking ahead, as a planner would: is there a branch for a placement that touches nothing else?

It knows what flight software knows, the nominal model of rover and terrain, and nothing of the built arm.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import mujoco
import numpy as np

from fsw.config import Config, configure
from fsw.estimate.joints import JointEstimate, unreferenced
from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.statics import Equilibrium, settle
from fsw.kinematics.transforms import Array
from fsw.motion.paths import Path, joint_path
from fsw.motion.plan import Refusal
from fsw.motion.plan_line import plan_guarded
from fsw.motion.plan_tool import AUTO, plan_tool
from sim.arms import BuiltArm
from sim.params import digest
from sim.placement import Placement, placement_moves
from sim.plant import Plant
from sim.world import World, build

VIA_M = 0.25
CLEARANCE_M = 0.03
SPACING_RAD = 0.02
SPRINGS = ("rover", "link1", "link2", "link3", "link4")


@dataclass(frozen=True, slots=True, eq=False)
class Preview:
    """The placement with a branch and a way that touch nothing, or why there is none."""

    placement: Placement
    problem: str | None
    duration_s: float
    """At most, from the ready pose to contact."""
    standoff_rad: Array
    """Motor angles at the standoff."""


def preview(arm: BuiltArm, world: World, placement: Placement) -> Preview:
    """The quickest free way from the ready pose, straight to the standoff or from above, on any branch."""
    config = configure(arm.params, digest(arm.params))
    spec = build(world)
    for geom in spec.geoms:
        geom.margin = 0.5 * CLEARANCE_M
    plant = Plant(spec.compile())
    ready = np.array(arm.params.poses.ready_rad)
    joints = replace(unreferenced(5), motor_rad=ready, gravity_R_m_s2=world.gravity_N_m_s2)
    tried = []
    for via_m in (0.0, VIA_M):
        for branch in (AUTO, *BRANCHES):
            found = _try(config, plant, joints, replace(placement, branch=branch, via_m=via_m))
            if found.problem is None:
                return found
            tried.append(found)
    return tried[0]


def unstow_s(arm: BuiltArm) -> float:
    """How long the arm takes from the stowed to the ready pose."""
    config, poses = configure(arm.params, digest(arm.params)), arm.params.poses
    way = [np.array(pose) for pose in (poses.stowed_rad, *poses.unstow_via_rad, poses.ready_rad)]
    return sum(joint_path(config, start, end).duration_s for start, end in pairwise(way))


def _try(config: Config, plant: Plant, joints: JointEstimate, placement: Placement) -> Preview:
    moves, touch = placement_moves(placement)
    duration = 0.0
    for move in moves:
        plan = plan_tool(config, joints, move)
        if isinstance(plan, Refusal):
            return _no(placement, plan.reason)
        hit = _first_hit(plant, _poses(config, joints, plan.paths[0]))
        if hit is not None:
            return _no(placement, f"{plan.branch}: {hit} on the way to the standoff")
        duration += plan.paths[0].duration_s
        joints = replace(joints, motor_rad=plan.motor_rad)
        placement = replace(placement, branch=plan.branch or AUTO)
    line = plan_guarded(config, joints, touch)
    if isinstance(line, Refusal):
        return _no(placement, line.reason)
    return Preview(placement, None, duration + line.paths[0].duration_s, joints.motor_rad)


def _no(placement: Placement, problem: str) -> Preview:
    return Preview(placement, problem, 0.0, np.zeros(5))


def _poses(config: Config, joints: JointEstimate, path: Path) -> Equilibrium:
    start, end = path.at(0.0).motor_rad, path.at(path.duration_s).motor_rad
    samples = int(np.abs(end - start).max() / SPACING_RAD) + 2
    way = np.array([path.at(t).motor_rad for t in np.linspace(0, path.duration_s, samples)]).T
    return settle(config.arm, way, np.zeros_like(way), joints.gravity_R_m_s2)


def _first_hit(plant: Plant, poses: Equilibrium) -> str | None:
    """Which two geoms meet first at these poses."""
    model, data = plant.model, plant.data
    springs = np.array(
        [
            [model.joint(f"{s}_{axis}").qposadr[0] for axis in ("rx", "ry", "rz", "tx", "ty", "tz")]
            for s in SPRINGS
        ]
    )
    for output, strain in zip(poses.output_rad.T, np.moveaxis(poses.strain, -1, 0), strict=True):
        data.qpos[plant.at.motor] = output
        data.qpos[springs] = strain[:, : len(SPRINGS)].T
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        if data.ncon:
            return " meets ".join(_geom_name(model, geom) for geom in data.contact[0].geom)
    return None


def _geom_name(model: mujoco.MjModel, geom: int) -> str:
    """A geom by its name, or by the part of the arm that carries it."""
    name: str = model.geom(geom).name or model.body(model.geom_bodyid[geom]).name
    return name
