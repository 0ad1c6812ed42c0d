"""How a tilted rover is drawn: flight software and plant know the tilt only as the direction of gravity."""

from typing import Final

import mujoco
import numpy as np

from fsw.kinematics.transforms import Array

CENTRE_M: Final = np.array([0.5, 0.0, 0.0])
"""Of the slope, in world axes from the rover's origin: rover and workspace lie about it."""
RADIUS_M: Final = 2.3
"""Of the slope: beyond the rear wheels and the reach of the arm."""


def tilt_rover(spec: mujoco.MjSpec) -> None:
    """Turn rover, arm and rock until gravity points down, on a slope whose lower edge lies in the plain.

    Plain, scenery, sky, light and cameras stay level, and so does the horizon. A level rover stays as it is.
    """
    gravity = spec.option.gravity.copy()
    if not gravity[:2].any():
        return
    g_m_s2 = float(np.linalg.norm(gravity))
    quat = np.zeros(4)
    mujoco.mju_quatZ2Vec(quat, -gravity / g_m_s2)
    mujoco.mju_negQuat(quat, quat)
    spec.option.gravity = (0.0, 0.0, -g_m_s2)
    ground, scenery = spec.geom("ground"), spec.body("mars_scenery")
    middle = CENTRE_M + ground.pos
    frame = spec.worldbody.add_frame(pos=middle - _turned(quat, middle), quat=quat)
    if spec.camera("target") is not None:
        face = spec.body("rock").pos
        spec.camera("target").pos += frame.pos + _turned(quat, face) - face
    for one in (*spec.worldbody.bodies, *spec.worldbody.geoms):
        if one not in (ground, scenery):
            one.set_frame(frame)
    drop_m = RADIUS_M * float(np.linalg.norm(gravity[:2])) / g_m_s2
    for one in (ground, scenery):
        if one is not None:
            one.pos[2] -= drop_m
    spec.worldbody.add_geom(
        name="slope",
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        pos=middle - (0.0, 0.0, 2.0 * drop_m),
        size=(RADIUS_M, 2.0 * drop_m, 0.0),
        contype=0,
        conaffinity=0,
        group=2,
        material=ground.material,
    ).set_frame(frame)


def _turned(quat: Array, v: Array) -> Array:
    turned = np.zeros(3)
    mujoco.mju_rotVecQuat(turned, v, quat)
    return turned
