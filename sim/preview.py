"""Looking ahead, as a planner would: is there a branch for a placement that touches nothing else?

It knows what flight software knows, the nominal model of rover and terrain, and nothing of the built arm.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import mujoco
import numpy as np

from fsw.config import Config, configure
from fsw.estimate.joints import JointEstimate, unreferenced
from fsw.kinematics.ik import BRANCHES
from fsw.kinematics.statics import Equilibrium, settle
from fsw.motion.paths import JointPath, joint_path
from fsw.motion.plan import AUTO, Refusal, plan_guarded, plan_tool
from sim.arms import BuiltArm
from sim.params import digest
from sim.placement import Placement, placement_moves
from sim.plant import Plant
from sim.world import World, build

SAMPLES = 60
VIA_M = 0.25
SPRINGS = ("rover", "link1", "link2", "link3", "link4")


@dataclass(frozen=True, slots=True)
class Preview:
    """The placement with a branch and a way that touch nothing, or why there is none."""

    placement: Placement
    problem: str | None
    duration_s: float
    """At most, from the ready pose to contact."""


def preview(arm: BuiltArm, world: World, placement: Placement) -> Preview:
    """The quickest free way from the ready pose, straight to the standoff or from above, on any branch."""
    config = configure(arm.params, digest(arm.params))
    plant = Plant(build(world).compile())
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
        goal = plan_tool(config, joints, move)
        if isinstance(goal, Refusal):
            return Preview(placement, goal.reason, 0.0)
        path = joint_path(config, joints.motor_rad, goal.motor_rad)
        hit = _first_hit(plant, _poses(config, joints, path))
        if hit is not None:
            return Preview(placement, f"{goal.branch}: {hit} on the way to the standoff", 0.0)
        duration += path.duration_s
        joints = replace(joints, motor_rad=goal.motor_rad)
        placement = replace(placement, branch=goal.branch)
    line = plan_guarded(config, joints, touch)
    if isinstance(line, Refusal):
        return Preview(placement, line.reason, 0.0)
    return Preview(placement, None, duration + line.length_m / config.params.motion.guarded_speed_m_s)


def _poses(config: Config, joints: JointEstimate, path: JointPath) -> Equilibrium:
    way = np.array([path.at(t).motor_rad for t in np.linspace(0, path.duration_s, SAMPLES)])
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
    for output, strain in zip(poses.output_rad, poses.strain, strict=True):
        data.qpos[plant.at.motor] = output
        data.qpos[springs] = strain[: len(SPRINGS)]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        if data.ncon:
            return " meets ".join(_geom_name(model, geom) for geom in data.contact[0].geom)
    return None


def _geom_name(model: mujoco.MjModel, geom: int) -> str:
    """A geom by its name, or by the part of the arm that carries it."""
    name: str = model.geom(geom).name or model.body(model.geom_bodyid[geom]).name
    return name
