"""Contact forces on a tool, against MuJoCo's sensors and against their sum."""

import mujoco
import numpy as np
import pytest

from fsw.config import configure
from fsw.kinematics.ik import inverse_kinematics
from sim.arms import arm_named
from sim.clearance import tool_forces
from sim.frames import FLIP, p_R_from_N
from sim.plant import Plant
from sim.setting import Surface, World
from sim.world import build
from tests.sim import lab
from tests.tools import TOOL_SWITCHES, tool_index

DEEP_M = 0.004
"""Depth to which the motors would move the tool into the rock."""
SETTLE_S = 16.0


def press_tool(
    tool: str, point_N_m: tuple[float, float, float], normal_N: tuple[float, float, float]
) -> Plant:
    """Return the arm at rest with a tool pressed against a rock."""
    world = World(surface=Surface(point_N_m, normal_N))
    normal = np.array(normal_N) / np.linalg.norm(normal_N)
    config = configure(arm_named("nominal").params)
    target = p_R_from_N(np.array(point_N_m)) - DEEP_M * normal
    answers = inverse_kinematics(config.arm, tool, target, -normal, np.zeros(3), lab.READY_RAD)
    slot = np.flatnonzero(answers.verdict == 0)[0]
    plant = Plant(build(world).compile())
    plant.place(answers.output_rad[:, slot], SETTLE_S)
    return plant


@pytest.fixture(scope="module", params=[("drill", (0.0, 0.0, -1.0)), ("apxs", (-0.5, 0.1, -0.85))])
def contact(request):
    tool, normal = request.param
    plant = press_tool(tool, (2.05, 0.1, -0.25), normal)
    return plant, tool, np.array(normal) / np.linalg.norm(normal)


def test_a_pressed_tool_is_pushed_out_of_the_rock_with_what_sensors_and_mujoco_say_and_no_other_is(contact):
    plant, tool, normal = contact
    forces = tool_forces(plant)
    force_N = forces[tool_index(tool)]
    assert force_N @ normal > 10.0
    assert not np.delete(forces, tool_index(tool), axis=0).any()
    sensors = [plant.model.sensor(switch).id for switch in TOOL_SWITCHES[tool]]
    measured_N = plant.data.sensordata[plant.model.sensor_adr[sensors]].sum()
    assert force_N @ normal == pytest.approx(measured_N, rel=1e-6)
    mujoco.mj_rnePostConstraint(plant.model, plant.data)
    external = plant.data.cfrc_ext[plant.model.body(tool).id, 3:]
    assert force_N == pytest.approx(FLIP * external, rel=1e-9, abs=1e-9)


def test_what_touches_nothing_feels_nothing():
    plant = lab.plant()
    plant.place(lab.READY_RAD, 1.0)
    assert not tool_forces(plant).any()
