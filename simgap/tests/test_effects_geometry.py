"""Effects of geometry against compiled models and the statics of a pendulum."""

import mujoco
import numpy as np
import pytest

from helpers.effect_lab import ARM_XML, PENDULUM_XML, changed, inverse_Nm, robot_of
from simgap.effects.inertia import GravityDirection, LinkLength, level_axes

ARM = robot_of(ARM_XML)
LENGTH_M = float(np.hypot(0.15, 0.03))


def test_link_length_moves_the_next_joint_along_the_link():
    x, _, z = np.array((0.15, 0, -0.03)) * (1 + 0.03 / LENGTH_M)
    fresh = ARM_XML.replace('pos="0.15 0 -0.03"', f'pos="{x:.16g} 0 {z:.16g}"')
    expected = inverse_Nm(mujoco.MjModel.from_xml_string(fresh), seed=1)
    model = changed(ARM, (LinkLength("lift", "elbow", LENGTH_M),), [[0.03]]).get_model(0)
    np.testing.assert_allclose(inverse_Nm(model, seed=1), expected, rtol=1e-9)


def test_a_tilt_about_the_joint_axis_shifts_the_rest_of_a_pendulum():
    model = changed(robot_of(PENDULUM_XML), (GravityDirection("base"),), [[0.0, 0.1]]).get_model(0)
    data = mujoco.MjData(model)
    data.qpos[0] = 0.1  # gravity turned by 0.1 rad about y, as the joint
    mujoco.mj_inverse(model, data)
    assert data.qfrc_inverse[0] == pytest.approx(0.0, abs=1e-12)
    data.qpos[0] = 0.6
    mujoco.mj_inverse(model, data)
    assert data.qfrc_inverse[0] == pytest.approx(0.5 * 9.81 * 0.2 * np.sin(0.5), rel=1e-9)


def test_gravity_keeps_its_magnitude_at_large_tilts():
    batch = changed(ARM, (GravityDirection("base"),), [[0.4, 0.0], [0.0, -0.4], [0.3, 0.4]])
    strength = np.linalg.norm(batch.expand("opt.gravity"), axis=1)
    np.testing.assert_allclose(strength, 9.81, rtol=1e-12)


def test_axes_across_gravity_are_level_for_any_direction_of_gravity():
    for gravity in ((0, 0, -9.81), (0, -9.81, 0), (9.81, 0, 0), (3.0, 4.0, 5.0)):
        axes = level_axes(np.array(gravity, float))
        np.testing.assert_allclose(axes @ gravity, 0, atol=1e-12)
        np.testing.assert_allclose(axes @ axes.T, np.eye(2), atol=1e-12)


def test_tilt_axes_are_x_and_y_where_gravity_is_along_z():
    np.testing.assert_allclose(level_axes(np.array((0, 0, -9.81))), ((1, 0, 0), (0, 1, 0)), atol=1e-15)


@pytest.mark.parametrize("effect", [LinkLength("lift", "elbow", LENGTH_M), GravityDirection("base")])
def test_a_size_of_zero_changes_no_bit_beside_a_simulation_with_the_effect(effect):
    number = len(effect.sizes)
    batch = changed(ARM, (effect,), [[0.0] * number, [one.typical for one in effect.sizes]])
    for sim, is_nominal in ((0, True), (1, False)):
        equal = np.array_equal(inverse_Nm(batch.get_model(sim), seed=6), inverse_Nm(ARM.model, seed=6))
        assert equal == is_nominal
