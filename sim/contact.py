"""Contact forces on the tools and on the rover."""

from typing import Final

import mujoco
import numpy as np

from fsw.kinematics.transforms import Array
from sim.arm_model.mjcf import HULL
from sim.frames import FLIP
from sim.plant import Plant

DOCK: Final = "bit_box"


def tool_forces(plant: Plant) -> Array:
    """Compute the contact force on each tool, friction included.

    Returns:
        Forces [N] in RMECH axes, shape (n, 3), in the order of the tools.
    """
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


def hull_force_N(plant: Plant) -> float:
    """Return the largest normal force between the arm and the rover, the bit boxes excluded."""
    model, data = plant.model, plant.data
    largest_N, wrench = 0.0, np.zeros(6)
    for k in range(data.ncon):
        geoms = [model.geom(geom) for geom in data.contact.geom[k]]
        if any(model.body(geom.bodyid[0]).name == HULL and not geom.name.startswith(DOCK) for geom in geoms):
            mujoco.mj_contactForce(model, data, k, wrench)
            largest_N = max(largest_N, float(wrench[0]))
    return largest_N
