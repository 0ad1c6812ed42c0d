"""Least distances of the arm to rover, ground and itself, and contact forces on tools and rover."""

from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np

from fsw.dictionary.params import Params
from fsw.kinematics.arm import Arm, build_arm
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array
from sim.arm_model.load import ArmModel
from sim.frames import FLIP
from sim.plant import Plant
from sim.setting import World
from sim.world import build

PLANE: Final = int(mujoco.mjtGeom.mjGEOM_PLANE)
"""As a number, which NumPy compares ten times faster."""
MAX_CLEARANCE_M: Final = 0.3
"""Upper bound of the reported clearances."""


@dataclass(frozen=True, slots=True)
class Gap:
    """Least distance between two parts over some poses; negative where one is inside the other."""

    distance_m: float = MAX_CLEARANCE_M
    parts: tuple[str, str] = ("", "")
    pose: int = 0
    """Index of the pose."""


@dataclass(frozen=True, slots=True)
class Clearance:
    """Least gap of the arm to rover or ground, and between its parts that are not neighbours."""

    outside: Gap
    within: Gap

    @property
    def outside_m(self) -> float:
        """Return the least distance to rover or ground."""
        return self.outside.distance_m

    @property
    def self_m(self) -> float:
        """Return the least distance between parts of the arm."""
        return self.within.distance_m

    @property
    def least(self) -> Gap:
        """Return the lesser gap."""
        return min(self.outside, self.within, key=lambda gap: gap.distance_m)


class ClearanceModel:
    """Model of the arm in a world, which measures clearances."""

    def __init__(self, params: Params, world: World, arm: ArmModel | None = None):
        self.plant = Plant(build(world, arm).compile())
        self.arm: Arm = build_arm(params)
        self.gravity_R_m_s2 = world.gravity_N_m_s2
        model = self.plant.model
        own = [geom for geom in range(model.ngeom) if model.geom_contype[geom] == 1]
        others = [geom for geom in range(model.ngeom) if model.geom_contype[geom] == 2]
        self._outside = np.array([(a, b) for a in own for b in others])
        link = {geom: _link_number(model, geom) for geom in own}  # the turret and its tools are one
        self._self = np.array([(a, b) for a in own for b in own if link[b] - link[a] >= 2])

    def clearance(self, poses_rad: Array) -> Clearance:
        """Compute the least clearances over poses, (5, n), with the arm deflected by gravity."""
        strain = np.moveaxis(settle_output(self.arm, poses_rad, self.gravity_R_m_s2).strain, -1, 0)
        outside = within = Gap()
        for pose, (output, springs) in enumerate(zip(poses_rad.T, strain, strict=True)):
            self.plant.show(output, springs)
            outside = self._least(self._outside, pose, outside)
            within = self._least(self._self, pose, within)
        return Clearance(outside, within)

    def _least(self, pairs: Array, pose: int, least: Gap) -> Gap:
        """Return the least gap of these pairs of geoms in the pose shown, or `least` if that is less.

        The pairs with the nearest bounding spheres come first, so that the search can stop early.
        """
        model, data = self.plant.model, self.plant.data
        one, other = pairs.T
        spheres = np.linalg.norm(data.geom_xpos[one] - data.geom_xpos[other], axis=1)
        spheres -= model.geom_rbound[one] + model.geom_rbound[other]
        plane = model.geom_type[other] == PLANE
        spheres[plane] = data.geom_xpos[one[plane], 2] - model.geom_rbound[one[plane]]
        for k in np.argsort(spheres):
            if spheres[k] >= least.distance_m:
                break
            pair = int(one[k]), int(other[k])
            distance_m = mujoco.mj_geomDistance(model, data, *pair, least.distance_m, None)
            if distance_m < least.distance_m:
                least = Gap(distance_m, (_part_name(model, pair[0]), _part_name(model, pair[1])), pose)
        return least


def _part_name(model: mujoco.MjModel, geom: int) -> str:
    """Return the name of the body of the arm, or of the geom outside it, that a geom is."""
    is_own = model.geom_contype[geom] == 1
    name: str = model.body(model.geom_bodyid[geom]).name if is_own else model.geom(geom).name
    return name.replace("_", " ")


def _link_number(model: mujoco.MjModel, geom: int) -> int:
    body = model.geom_bodyid[geom]
    while not model.body(body).name.removeprefix("link").isdigit():
        body = model.body_parentid[body]
    return int(model.body(body).name.removeprefix("link"))


def tool_forces(plant: Plant) -> Array:
    """Compute the contact force on each tool, friction included, (n, 3) [N] in RMECH axes."""
    model, data = plant.model, plant.data
    total = np.zeros((len(plant.tools), 3))
    if data.ncon == 0:
        return total
    wrench = np.zeros(6)
    bodies = model.geom_bodyid[data.contact.geom]
    for n, tool in enumerate(plant.tools):
        is_tool = bodies == model.body(tool).id
        for k in np.flatnonzero(is_tool.any(axis=1)):
            mujoco.mj_contactForce(model, data, k, wrench)
            force_W = data.contact.frame[k].reshape(3, 3).T @ wrench[:3]  # of the first geom on the second
            total[n] += FLIP * force_W * (1.0 if is_tool[k, 1] else -1.0)
    return total
