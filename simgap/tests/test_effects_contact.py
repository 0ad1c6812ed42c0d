"""Contact of the tool with a plane: rest on it, and no trace of it at size 0."""

import mujoco
import numpy as np
import pytest

from helpers.effect_lab import ARM_XML, PENDULUM_XML, changed, robot_of
from simgap.effects.forces import PlaneContact

PENDULUM = robot_of(PENDULUM_XML)
PLANE = PlaneContact("tool", lowest_m=-0.3, high_m=0.3)


def swing(batch, start_rad, n_steps):
    batch.qpos[:] = start_rad
    batch.rollout(n_steps, None, record=("qpos",))
    return batch.bind("qpos")[:, 0].copy()


def test_a_pendulum_comes_to_rest_with_its_site_on_the_plane():
    batch = changed(PENDULUM, (PLANE,), [[0.05]])
    batch.ctrl = 0.0
    angle_rad = swing(batch, 1.2, 4000)
    data = batch.get_data(0)
    mujoco.mj_forward(batch.get_model(0), data)
    assert data.site("tool").xpos[2] == pytest.approx(-0.25, abs=3e-4)
    assert angle_rad[0] == pytest.approx(np.arccos(0.25 / 0.3), abs=3e-3)


def test_at_size_zero_the_plane_changes_no_bit_of_the_motion():
    batch = changed(PENDULUM, (PLANE,), [[0.0], [0.05]])
    without = mujoco.batch.Batch(PENDULUM.model, nsim=1, nthread=1)
    shown_rad, nominal_rad = swing(batch, 1.2, 1000), swing(without, 1.2, 1000)
    assert shown_rad[0] == nominal_rad[0]
    assert shown_rad[1] != nominal_rad[0]


def test_a_plane_below_the_motion_changes_no_bit_of_the_motion():
    batch = changed(PENDULUM, (PlaneContact("tool", -0.5, 0.3),), [[0.1]])
    without = mujoco.batch.Batch(PENDULUM.model, nsim=1, nthread=1)
    assert swing(batch, 1.2, 1000)[0] == swing(without, 1.2, 1000)[0]


def test_plane_and_tip_touch_nothing_else():
    xml = ARM_XML.replace(
        '<site name="tool"', '<geom size="0.05" pos="0.14 0 0.02" mass="0"/><site name="tool"'
    ).replace("<worldbody>", '<worldbody><geom type="plane" size="1 1 1" pos="0 0 -5"/>')
    batch = changed(robot_of(xml), (PlaneContact("tool", -10.0, 20.0),), [[0.0]])
    data, model = batch.get_data(0), batch.get_model(0)
    mujoco.mj_forward(model, data)
    assert data.ncon == 0


def test_the_plane_adds_no_mass():
    batch = changed(robot_of(ARM_XML), (PlaneContact("tool", -0.3, 0.3),), [[0.05]])
    np.testing.assert_array_equal(batch.get_model(0).body_mass, robot_of(ARM_XML).model.body_mass)


def test_the_size_is_told_as_a_height():
    assert PLANE.describe(np.array([0.255])) == "plane at z = -45.0 mm"
