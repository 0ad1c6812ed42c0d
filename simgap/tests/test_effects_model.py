"""Effects of mass, geometry and contact against changed models; backlash, compliance, periodic errors."""

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from helpers.effect_lab import ARM_XML, PENDULUM_XML, changed, inverse_Nm, robot_of, simulate
from simgap.effects import transmission
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


PERIOD_S = ARM.control_period_s
FLYWHEEL_XML = """
<mujoco model="flywheel">
  <option timestep="0.0005"/>
  <worldbody>
    <body name="wheel">
      <joint name="turn" axis="0 0 1" damping="{damping}" frictionloss="{dry}" armature="0.02"/>
      <inertial pos="0 0 0" mass="1" diaginertia="0.03 0.03 0.03"/>
    </body>
  </worldbody>
  <actuator><position name="turn" joint="turn" kp="8" kv="0.2" forcerange="-50 50"/></actuator>
</mujoco>
"""
LINK_KGM2, ROTOR_KGM2, KP, KD, DAMPING = 0.03, 0.02 + 0.01 * 0.05, 8.0, 0.2, 0.3


def flywheel(damping=DAMPING, dry=0.0):
    return robot_of(FLYWHEEL_XML.format(damping=damping, dry=dry), tool_site="")


def backlash(place="turn", index=0, encoder_is_at_output=True):
    return transmission.Backlash(place, index, encoder_is_at_output, typical=0.01, highest=0.1)


def compliance(place="turn", index=0, encoder_is_at_output=True):
    return transmission.JointCompliance(place, index, encoder_is_at_output, typical=0.02, highest=0.2)


def two_masses(stiffness, command_rad, time_s, encoder_is_at_output):
    """Integrate rotor and wheel with a spring between, and a loop that closes at one of them."""
    spring_damping = (
        2 * transmission.DAMPING_RATIO * np.sqrt(stiffness * transmission.gear_inertia_kgm2(flywheel(), 0))
    )

    def slope(t, x):
        rotor, wheel, rotor_speed, wheel_speed = x
        shown = wheel if encoder_is_at_output else rotor
        motor = KP * (command_rad - shown) - KD * rotor_speed
        spring = stiffness * (rotor - wheel) + spring_damping * (rotor_speed - wheel_speed)
        rotor_acceleration = (motor - DAMPING * rotor_speed - spring) / ROTOR_KGM2
        return rotor_speed, wheel_speed, rotor_acceleration, spring / LINK_KGM2

    found = solve_ivp(slope, (0, time_s[-1]), np.zeros(4), t_eval=time_s, rtol=1e-9, atol=1e-11)
    return found.y[1] if encoder_is_at_output else found.y[0]


@pytest.mark.parametrize("encoder_is_at_output", [True, False])
def test_a_compliant_joint_moves_as_two_masses_with_a_spring(encoder_is_at_output):
    robot, stiffness = flywheel(), 40.0
    effect = compliance(encoder_is_at_output=encoder_is_at_output)
    command = np.full((400, 1), 0.5)
    time_s = robot.control_period_s * np.arange(400)
    shown_rad = simulate(robot, (effect,), [[1 / stiffness]], command, [0.0])[0, 0]
    expected_rad = two_masses(stiffness, 0.5, time_s, encoder_is_at_output)
    rigid_rad = simulate(robot, (effect,), [[0.0]], command, [0.0])[0, 0]
    assert np.abs(shown_rad - expected_rad).max() < 0.05 * np.abs(rigid_rad - expected_rad).max()


def test_at_rest_an_output_encoder_does_not_see_the_compliance():
    effects = (compliance("lift", 1),)
    command = np.tile((0.0, 0.4, 0.0), (1000, 1))
    shown_rad = simulate(ARM, effects, [[0.0], [0.02]], command, [0.0, 0.4, 0.0])
    rest_rad = shown_rad[:, 1, -1]
    assert rest_rad[1] == pytest.approx(rest_rad[0], abs=2e-3)  # dry friction leaves this much: 0.05 / 20


@pytest.mark.parametrize(
    ("effect", "lower"),
    [
        (compliance("lift", 1, False), lambda size, load_Nm: size * load_Nm),
        (backlash("lift", 1, False), lambda size, load_Nm: np.sign(load_Nm) * size / 2),
    ],
    ids=["compliance", "backlash"],
)
def test_at_rest_the_output_under_a_motor_encoder_is_lower_by_what_the_load_does(effect, lower):
    robot, size = robot_of(ARM_XML.replace('frictionloss="0.05"', "")), 0.2
    command = np.tile((0.0, 0.4, 0.0), (2000, 1))
    motor_rad = simulate(robot, (effect,), [[size]], command, [0.0, 0.4, 0.0])[0, :, -1]
    load_Nm = 20 * (0.4 - motor_rad[1])
    data = mujoco.MjData(robot.model)
    data.qpos[:] = motor_rad
    data.qpos[1] -= lower(size, load_Nm)
    mujoco.mj_forward(robot.model, data)
    near = 1e-4 if isinstance(effect, transmission.JointCompliance) else 1e-3
    assert data.qfrc_bias[1] == pytest.approx(load_Nm, abs=near)


def test_a_reversal_loses_the_time_in_which_the_rotor_crosses_the_backlash():
    robot = flywheel(damping=0.1, dry=0.3)
    time_s = robot.control_period_s * np.arange(1200)
    command = 0.3 * np.sin(2 * np.pi * 0.5 * time_s)[:, None]
    rigid, loose = simulate(robot, (backlash(),), [[0.0], [0.05]], command, [0.0])[:, 0]
    away = np.abs(loose - rigid)
    assert away.max() > 0.005
    assert away.max() < 0.3


def test_backlash_and_compliance_at_one_joint_act_in_series_in_either_order():
    time_s = PERIOD_S * np.arange(300)
    command = np.stack((0 * time_s, 0.4 * np.sin(8 * time_s), 0 * time_s), axis=1)
    both = (backlash("lift", 1), compliance("lift", 1))
    one = simulate(ARM, both, [[0.02, 0.01], [0.02, 0.0], [0.0, 0.01]], command, np.zeros(3))
    other = simulate(ARM, both[::-1], [[0.01, 0.02], [0.0, 0.02], [0.01, 0.0]], command, np.zeros(3))
    np.testing.assert_array_equal(one, other)
    assert np.abs(one[0] - one[1]).max() > 1e-3
    assert np.abs(one[0] - one[2]).max() > 1e-3


def test_a_gear_stiffer_than_the_time_step_resolves_still_moves_as_a_rigid_one():
    time_s = PERIOD_S * np.arange(300)
    command = np.stack((0 * time_s, 0.4 * np.sin(3 * time_s), 0 * time_s), axis=1)
    rigid, stiff = simulate(ARM, (compliance("lift", 1),), [[0.0], [1e-9]], command, np.zeros(3))[:, 1]
    assert np.abs(stiff - rigid).max() < 2e-3


def test_a_coupled_joint_relieves_the_motor_of_its_neighbour_of_a_part_of_its_load():
    robot = robot_of(ARM_XML.replace('frictionloss="0.05"', "").replace('frictionloss="0.04"', ""))
    coupling = transmission.JointCoupling("elbow", 2, "lift", 1, typical_ratio=0.05)
    command = np.tile((0.0, 0.3, 0.0), (2000, 1))
    alone, coupled = simulate(robot, (coupling,), [[0.0], [0.1]], command, [0.0, 0.3, 0.0])[:, :, -1]
    data_load_Nm = 10 * (0.0 - alone[2])  # torque with which the loop of the elbow carries the elbow
    assert coupled[1] - alone[1] == pytest.approx(0.1 * data_load_Nm / 20, rel=0.1)


ANGLES_RAD = np.linspace(-4, 4, 401)[None, :]


def smooth_size(seed):
    effect = transmission.SmoothPeriodicError("a", 2e-3)
    widths = np.array([size.prior_std for size in effect.sizes])
    return effect, np.random.default_rng(seed).normal(0, widths)[None, :]


def test_an_error_of_one_order_repeats_that_often_in_a_turn():
    effect = transmission.PeriodicError("a", 5, 1e-3)
    size = np.array([[3e-3, -4e-3]])
    error_rad = effect.encode(size, ANGLES_RAD) - ANGLES_RAD
    later_rad = effect.encode(size, ANGLES_RAD + 2 * np.pi / 5) - ANGLES_RAD - 2 * np.pi / 5
    np.testing.assert_allclose(error_rad, later_rad, atol=1e-12)
    assert np.abs(error_rad).max() == pytest.approx(5e-3, rel=1e-3)
    assert effect.describe(size[0]) == "5 mrad with 5 periods a turn, phase -0.93 rad"


@pytest.mark.parametrize("order", [1, 2, 48, 256])
def test_decode_inverts_encode_at_the_bound(order):
    effect = transmission.PeriodicError("a", order, 1e-3)
    size = np.array([[one.high for one in effect.sizes]])
    shown_rad = effect.encode(size, ANGLES_RAD)
    np.testing.assert_allclose(effect.decode(size, shown_rad), ANGLES_RAD, atol=1e-9)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_decode_inverts_encode_of_many_orders(seed):
    effect, size = smooth_size(seed)
    shown_rad = effect.encode(size, ANGLES_RAD)
    np.testing.assert_allclose(effect.decode(size, shown_rad), ANGLES_RAD, atol=1e-12)


def test_many_orders_are_the_sum_of_single_ones():
    effect, size = smooth_size(4)
    orders = ((transmission.PeriodicError("a", k + 1, 1e-3), size[:, 2 * k : 2 * k + 2]) for k in range(48))
    single = sum(one.encode(own, ANGLES_RAD) - ANGLES_RAD for one, own in orders)
    np.testing.assert_allclose(effect.encode(size, ANGLES_RAD) - ANGLES_RAD, single, atol=1e-14)


@pytest.mark.parametrize(
    "effect", [transmission.PeriodicError("a", 3, 1e-3), transmission.SmoothPeriodicError("a", 1e-3)]
)
def test_a_size_of_zero_changes_no_bit(effect):
    size = np.zeros((1, len(effect.sizes)))
    for job in (effect.encode, effect.decode):
        np.testing.assert_array_equal(job(size, ANGLES_RAD), ANGLES_RAD)
