"""What touches the tools, and with what force."""

import mujoco
import numpy as np

from fsw.dictionary.joints import Tool
from fsw.kinematics.transforms import Array
from sim.frames import FLIP
from sim.plant import Plant


def tool_forces(plant: Plant) -> Array:
    """The force of the world on each tool, friction too [N]: (5, 3), in the order of Tool, RMECH axes."""
    model, data = plant.model, plant.data
    tool_of = {model.body(tool.name.lower()).id: tool for tool in Tool}
    total, wrench = np.zeros((len(Tool), 3)), np.zeros(6)
    for k, contact in enumerate(data.contact[: data.ncon]):
        mujoco.mj_contactForce(model, data, k, wrench)
        force_W = contact.frame.reshape(3, 3).T @ wrench[:3]  # of the first geom on the second
        for geom, sign in ((contact.geom1, -1.0), (contact.geom2, 1.0)):
            tool = tool_of.get(int(model.geom_bodyid[geom]))
            if tool is not None:
                total[tool] += sign * FLIP * force_W
    return total
