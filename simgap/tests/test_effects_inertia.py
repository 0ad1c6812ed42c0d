"""Effects of mass against models that are compiled with the changed numbers."""

import mujoco
import numpy as np
import pytest

from helpers.effect_lab import ARM_XML, PENDULUM_XML, changed, inverse_Nm, robot_of
from simgap.effects.inertia import LinkCentre, LinkInertia, LinkMass, Payload

ARM = robot_of(ARM_XML)
FOREARM = 'pos="0.06 0 0.01" mass="0.15" diaginertia="1e-4 3e-4 3e-4"'
AXES = "xyz"


def test_a_payload_at_the_tool_equals_a_model_with_that_body():
    payload = Payload("elbow", "tool", 0.1, 1.0)
    point = (
        '<body pos="0.14 0 0.02"><inertial pos="0 0 0" mass="0.4" diaginertia="1e-12 1e-12 1e-12"/></body>'
    )
    fresh = ARM_XML.replace('<site name="tool"', point + '<site name="tool"')
    expected = inverse_Nm(mujoco.MjModel.from_xml_string(fresh), seed=1)
    model = changed(ARM, (payload,), [[0.4]]).get_model(0)
    np.testing.assert_allclose(inverse_Nm(model, seed=1), expected, rtol=1e-9, atol=1e-9)


def test_a_payload_at_the_centre_of_a_link_with_turned_axes_equals_more_mass():
    payload = Payload("lift", "", 0.1, 1.0)
    fresh = ARM_XML.replace('mass="0.3" diaginertia="5e-4', 'mass="0.5" diaginertia="5e-4')
    expected = inverse_Nm(mujoco.MjModel.from_xml_string(fresh), seed=2)
    model = changed(ARM, (payload,), [[0.2]]).get_model(0)
    np.testing.assert_allclose(inverse_Nm(model, seed=2), expected, rtol=1e-9, atol=1e-9)


def test_a_payload_where_the_centre_was_on_the_joint_couples_the_joint_to_gravity():
    xml = PENDULUM_XML.replace('pos="0 0 -0.2" mass', 'pos="0 0 0" mass')
    model = changed(robot_of(xml), (Payload("swing", "tool", 0.1, 1.0),), [[0.5]]).get_model(0)
    data = mujoco.MjData(model)
    data.qpos[0] = 0.7
    mujoco.mj_inverse(model, data)
    assert data.qfrc_inverse[0] == pytest.approx(0.5 * 9.81 * 0.3 * np.sin(0.7), rel=1e-9)


def test_link_mass_scales_mass_and_inertia():
    fresh = ARM_XML.replace(FOREARM, 'pos="0.06 0 0.01" mass="0.30" diaginertia="2e-4 6e-4 6e-4"')
    expected = inverse_Nm(mujoco.MjModel.from_xml_string(fresh), seed=3)
    model = changed(ARM, (LinkMass("elbow", 0.15),), [[0.15]]).get_model(0)
    np.testing.assert_allclose(inverse_Nm(model, seed=3), expected, rtol=1e-9)


def test_link_centre_moves_outward_from_the_axis_and_across():
    outward = np.array((0.06, 0, 0.01)) / np.hypot(0.06, 0.01)
    x, _, z = np.array((0.06, 0, 0.01)) + 0.02 * outward + 0.01 * np.cross((0, 1, 0), outward)
    fresh = ARM_XML.replace(FOREARM, f'pos="{x:.15g} 0 {z:.15g}" mass="0.15" diaginertia="1e-4 3e-4 3e-4"')
    expected = inverse_Nm(mujoco.MjModel.from_xml_string(fresh), seed=4)
    model = changed(ARM, (LinkCentre("elbow", 0.15),), [[0.02, 0.01]]).get_model(0)
    np.testing.assert_allclose(inverse_Nm(model, seed=4), expected, rtol=1e-9)


def test_link_inertia_adds_to_the_joint_torque_of_an_acceleration():
    model = changed(robot_of(PENDULUM_XML), (LinkInertia("swing", -1e-4, 0.03),), [[0.005]]).get_model(0)
    nominal, data = robot_of(PENDULUM_XML).model, mujoco.MjData(model)
    data.qacc[0] = 2.0
    mujoco.mj_inverse(model, data)
    with_effect = data.qfrc_inverse[0]
    mujoco.mj_inverse(nominal, data)
    assert with_effect - data.qfrc_inverse[0] == pytest.approx(0.005 * 2.0, rel=1e-9)


def test_two_effects_of_mass_on_one_link_add_up():
    both = (LinkMass("elbow", 0.15), Payload("elbow", "tool", 0.1, 1.0))
    point = (
        '<body pos="0.14 0 0.02"><inertial pos="0 0 0" mass="0.4" diaginertia="1e-12 1e-12 1e-12"/></body>'
    )
    fresh = ARM_XML.replace('<site name="tool"', point + '<site name="tool"')
    fresh = fresh.replace(FOREARM, 'pos="0.06 0 0.01" mass="0.30" diaginertia="2e-4 6e-4 6e-4"')
    expected = inverse_Nm(mujoco.MjModel.from_xml_string(fresh), seed=5)
    model = changed(ARM, both, [[0.15, 0.4]]).get_model(0)
    np.testing.assert_allclose(inverse_Nm(model, seed=5), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(
    "effect",
    [
        Payload("elbow", "tool", 0.1, 1.0),
        LinkMass("lift", 0.3),
        LinkCentre("lift", 0.1),
        LinkInertia("pan", -1e-4, 0.1),
    ],
    ids=lambda effect: effect.name,
)
def test_a_size_of_zero_changes_no_bit_beside_a_simulation_with_the_effect(effect):
    number = len(effect.sizes)
    typical = [one.typical for one in effect.sizes]
    batch = changed(ARM, (effect,), [[0.0] * number, typical])
    for sim, is_nominal in ((0, True), (1, False)):
        equal = np.array_equal(inverse_Nm(batch.get_model(sim), seed=6), inverse_Nm(ARM.model, seed=6))
        assert equal == is_nominal
