"""Effects of mass, geometry and contact against models that are compiled with the changed numbers."""

import mujoco
import numpy as np
import pytest

from helpers.effect_lab import ARM_XML, PENDULUM_XML, changed, inverse_Nm, robot_of
from simgap.effects.forces import PlaneContact
from simgap.effects.inertia import (
    GravityDirection,
    LinkCentre,
    LinkInertia,
    LinkLength,
    LinkMass,
    Payload,
    level_axes,
)

ARM = robot_of(ARM_XML)
FOREARM = 'pos="0.06 0 0.01" mass="0.15" diaginertia="1e-4 3e-4 3e-4"'
POINT = '<body pos="0.14 0 0.02"><inertial pos="0 0 0" mass="0.4" diaginertia="1e-12 1e-12 1e-12"/></body>'
WITH_POINT = ARM_XML.replace('<site name="tool"', POINT + '<site name="tool"')
LENGTH_M = float(np.hypot(0.15, 0.03))
PENDULUM = robot_of(PENDULUM_XML)
PLANE = PlaneContact("tool", lowest_m=-0.3, high_m=0.3)


def assert_equal_torques(effects, sizes, xml, atol=0.0):
    """Check that effects give the model the torques of a model with this text."""
    expected = inverse_Nm(mujoco.MjModel.from_xml_string(xml), seed=1)
    model = changed(ARM, effects, [sizes]).get_model(0)
    np.testing.assert_allclose(inverse_Nm(model, seed=1), expected, rtol=1e-9, atol=atol)


def pendulum_torque_Nm(effect, sizes, angle_rad, xml=PENDULUM_XML):
    """Return the torque that holds a pendulum with an effect."""
    model = changed(robot_of(xml), (effect,), [sizes]).get_model(0)
    data = mujoco.MjData(model)
    data.qpos[0] = angle_rad
    mujoco.mj_inverse(model, data)
    return data.qfrc_inverse[0]


def test_a_payload_beside_the_tool_equals_a_model_with_that_body_there():
    place_m = np.array((0.14, 0.0, 0.02)) + np.array((0.02, -0.03, 0.04))  # of the tool, and beside it
    body = POINT.replace("0.14 0 0.02", " ".join(f"{one:.15g}" for one in place_m))
    beside = ARM_XML.replace('<site name="tool"', body + '<site name="tool"')
    assert_equal_torques((Payload("elbow", "tool", 0.1, 1.0, 0.2),), [0.4, 0.02, -0.03, 0.04], beside, 1e-9)


def test_a_payload_at_the_centre_of_a_link_with_turned_axes_equals_more_mass():
    fresh = ARM_XML.replace('mass="0.3" diaginertia="5e-4', 'mass="0.5" diaginertia="5e-4')
    assert_equal_torques((Payload("lift", "", 0.1, 1.0, 0.2),), [0.2, 0.0, 0.0, 0.0], fresh, 1e-9)


def test_a_payload_where_the_centre_was_on_the_joint_couples_the_joint_to_gravity():
    xml = PENDULUM_XML.replace('pos="0 0 -0.2" mass', 'pos="0 0 0" mass')
    torque_Nm = pendulum_torque_Nm(Payload("swing", "tool", 0.1, 1.0, 0.2), [0.5, 0.0, 0.0, 0.0], 0.7, xml)
    assert torque_Nm == pytest.approx(0.5 * 9.81 * 0.3 * np.sin(0.7), rel=1e-9)


def test_link_centre_moves_outward_from_the_axis_and_across():
    outward = np.array((0.06, 0, 0.01)) / np.hypot(0.06, 0.01)
    x, _, z = np.array((0.06, 0, 0.01)) + 0.02 * outward + 0.01 * np.cross((0, 1, 0), outward)
    fresh = ARM_XML.replace(FOREARM, f'pos="{x:.15g} 0 {z:.15g}" mass="0.15" diaginertia="1e-4 3e-4 3e-4"')
    assert_equal_torques((LinkCentre("elbow", 0.15),), [0.02, 0.01], fresh)


def test_link_inertia_adds_to_the_joint_torque_of_an_acceleration():
    model = changed(robot_of(PENDULUM_XML), (LinkInertia("swing", -1e-4, 0.03),), [[0.005]]).get_model(0)
    nominal, data = robot_of(PENDULUM_XML).model, mujoco.MjData(model)
    data.qacc[0] = 2.0
    mujoco.mj_inverse(model, data)
    with_effect = data.qfrc_inverse[0]
    mujoco.mj_inverse(nominal, data)
    assert with_effect - data.qfrc_inverse[0] == pytest.approx(0.005 * 2.0, rel=1e-9)


def test_two_effects_of_mass_on_one_link_add_up():
    both = (LinkMass("elbow", 0.15), Payload("elbow", "tool", 0.1, 1.0, 0.2))
    fresh = WITH_POINT.replace(FOREARM, 'pos="0.06 0 0.01" mass="0.30" diaginertia="2e-4 6e-4 6e-4"')
    assert_equal_torques(both, [0.15, 0.4, 0.0, 0.0, 0.0], fresh, 1e-9)


def test_link_length_moves_the_next_joint_along_the_link():
    x, _, z = np.array((0.15, 0, -0.03)) * (1 + 0.03 / LENGTH_M)
    fresh = ARM_XML.replace('pos="0.15 0 -0.03"', f'pos="{x:.16g} 0 {z:.16g}"')
    assert_equal_torques((LinkLength("lift", "elbow", LENGTH_M),), [0.03], fresh)


def test_a_tilt_about_the_joint_axis_shifts_the_rest_of_a_pendulum():
    tilted = GravityDirection("base"), [0.0, 0.1]  # gravity turned by 0.1 rad about y, as the joint
    assert pendulum_torque_Nm(*tilted, 0.1) == pytest.approx(0.0, abs=1e-12)
    assert pendulum_torque_Nm(*tilted, 0.6) == pytest.approx(0.5 * 9.81 * 0.2 * np.sin(0.5), rel=1e-9)


def test_gravity_keeps_its_magnitude_at_large_tilts():
    batch = changed(ARM, (GravityDirection("base"),), [[0.4, 0.0], [0.0, -0.4], [0.3, 0.4]])
    strength = np.linalg.norm(batch.expand("opt.gravity"), axis=1)
    np.testing.assert_allclose(strength, 9.81, rtol=1e-12)


def test_axes_across_gravity_are_level_for_any_direction_of_gravity():
    for gravity in ((0, 0, -9.81), (0, -9.81, 0), (9.81, 0, 0), (3.0, 4.0, 5.0)):
        axes = level_axes(np.array(gravity, float))
        np.testing.assert_allclose(axes @ gravity, 0, atol=1e-12)
        np.testing.assert_allclose(axes @ axes.T, np.eye(2), atol=1e-12)


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


def test_plane_and_tip_touch_nothing_else_and_add_no_mass():
    tip = '<geom size="0.05" pos="0.14 0 0.02" mass="0"/><site name="tool"'
    floor = '<worldbody><geom type="plane" size="1 1 1" pos="0 0 -5"/>'
    xml = ARM_XML.replace('<site name="tool"', tip).replace("<worldbody>", floor)
    batch = changed(robot_of(xml), (PlaneContact("tool", -10.0, 20.0),), [[0.0]])
    data, model = batch.get_data(0), batch.get_model(0)
    mujoco.mj_forward(model, data)
    assert data.ncon == 0
    batch = changed(robot_of(ARM_XML), (PlaneContact("tool", -0.3, 0.3),), [[0.05]])
    np.testing.assert_array_equal(batch.get_model(0).body_mass, robot_of(ARM_XML).model.body_mass)
