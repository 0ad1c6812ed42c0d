"""The rock that a target is on."""

from typing import Final

import mujoco
import numpy as np

from fsw.kinematics.transforms import Array
from sim.frames import FLIP

ROCK_RADIUS_M: Final = 0.1
ROCK_HALF_DEPTH_M: Final = 0.04


def add_rock(spec: mujoco.MjSpec, p_N_m: Array, normal_N: Array) -> None:
    """A flat disc of rock that can be touched, on an outcrop that only looks, and a camera on it."""
    z = FLIP * normal_N
    z = z / np.linalg.norm(z)
    x = np.cross([0.0, 1.0, 0.0], z)
    x = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(x) < 1e-6 else x / np.linalg.norm(x)
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.column_stack([x, np.cross(z, x), z]).ravel())
    face = FLIP * p_N_m
    rock = spec.worldbody.add_body(name="rock", pos=face, quat=quat)
    rock.add_geom(
        name="rock_face",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        size=(ROCK_RADIUS_M, ROCK_HALF_DEPTH_M, 0),
        pos=(0, 0, -ROCK_HALF_DEPTH_M),
        contype=2,
        conaffinity=1,
        rgba=(0.66, 0.52, 0.42, 1),
    )
    _add_outcrop(spec, rock, face, z)
    _add_camera(spec, face)


def _add_camera(spec: mujoco.MjSpec, face: Array) -> None:
    """Camera `target`: the face, the turret on it and the arm behind, from the front starboard corner."""
    eye, seen = face + np.array([1.25, -1.0, 0.55]), face + np.array([-0.2, 0.05, 0.28])
    back = (eye - seen) / np.linalg.norm(eye - seen)
    right = np.cross([0.0, 0.0, 1.0], back)
    right = right / np.linalg.norm(right)
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.column_stack([right, np.cross(back, right), back]).ravel())
    spec.worldbody.add_camera(name="target", pos=eye, quat=quat, fovy=42)


def lower_ground(spec: mujoco.MjSpec, height_m: float) -> None:
    """Ground and scenery at a height (world z, not above 0); the rover then stands on a terrace."""
    if height_m == 0.0:
        return
    spec.geom("ground").pos[2] = height_m
    scenery = spec.body("mars_scenery")
    if scenery is not None:
        scenery.pos[2] = height_m
    spec.worldbody.add_geom(
        name="terrace",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=(-0.15, 0, 0.5 * height_m),
        size=(1.5, 1.5, -0.5 * height_m),
        contype=0,
        conaffinity=0,
        group=2,
        material=spec.geom("ground").material,
    )


def _add_outcrop(spec: mujoco.MjSpec, rock: mujoco.MjsBody, face: Array, z: Array) -> None:
    """Angular blocks around and below the face, none above it."""
    looks = {
        "type": mujoco.mjtGeom.mjGEOM_BOX,
        "contype": 0,
        "conaffinity": 0,
        "group": 2,
        "material": "mars_rock" if spec.material("mars_rock") else "",
        "rgba": (0.66, 0.58, 0.54, 1),
    }
    for pos, half, euler in (
        ((0.0, 0.0, -0.065), (0.13, 0.105, 0.06), (0.04, -0.05, 0.5)),
        ((0.08, 0.05, -0.13), (0.12, 0.11, 0.08), (-0.3, 0.2, 1.1)),
        ((-0.09, -0.04, -0.14), (0.12, 0.1, 0.09), (0.25, 0.3, -0.6)),
    ):
        rock.add_geom(pos=pos, size=half, euler=euler, **looks)
    foot = face - 0.16 * z
    if foot[2] > 0:
        half_m = 0.5 * foot[2] + 0.05
        foot[2] -= half_m
        spec.worldbody.add_geom(pos=foot, size=(0.14, 0.12, half_m), euler=(0.15, -0.1, 0.9), **looks)
