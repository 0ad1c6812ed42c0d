"""Clearances of the arm by MuJoCo, as a reference for those of flight software."""

from functools import lru_cache

import mujoco
import numpy as np

from fsw.collision.geometry import SURFACE
from sim.plant import Plant
from sim.setting import World
from sim.world import build
from tests.fsw.rig import beside_the_rover

NAMES = {"shoulder_bracket_2": "shoulder_bracket"}
FAR_M = 10.0
GEOMETRY = beside_the_rover().collision_geometry
PARTS, OBSTACLES = GEOMETRY.parts, GEOMETRY.obstacles[:SURFACE]


@lru_cache
def plant() -> Plant:
    """Build a plant with arm, rover and level ground."""
    return Plant(build(World()).compile())


def part_of(model: mujoco.MjModel, geom: int) -> str:
    name: str = model.body(model.geom_bodyid[geom]).name
    return name


def obstacle_of(model: mujoco.MjModel, geom: int) -> str:
    name = model.geom(geom).name
    return NAMES.get(name, name)


def mujoco_clearances(output_rad: np.ndarray, strain: np.ndarray) -> np.ndarray:
    """Compute the distances (PARTS, OBSTACLES, n) of MuJoCo's geoms at poses (5, n) and strains (6, 6, n)."""
    model, data = plant().model, plant().data
    arm, others = (
        [geom for geom in range(model.ngeom) if model.geom_contype[geom] == side] for side in (1, 2)
    )
    distance = np.full((len(PARTS), len(OBSTACLES), output_rad.shape[1]), np.inf)
    for k in range(output_rad.shape[1]):
        plant().show(output_rad[:, k], strain[:, :, k])
        for a in arm:
            i = PARTS.index(part_of(model, a))
            for b in others:
                j = OBSTACLES.index(obstacle_of(model, b))
                d = mujoco.mj_geomDistance(model, data, a, b, FAR_M, None)
                distance[i, j, k] = min(distance[i, j, k], d)
    return distance
