"""Backlash, compliance and periodic errors against an oscillator, statics, and the motion without them."""

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from helpers.effect_lab import ARM_XML, robot_of, simulate
from simgap.effects.transmission import (
    DAMPING_RATIO,
    Backlash,
    JointCompliance,
    JointCoupling,
    PeriodicError,
    SmoothPeriodicError,
    gear_inertia_kgm2,
)

ARM = robot_of(ARM_XML)
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
    return Backlash(place, index, encoder_is_at_output, typical=0.01, highest=0.1)


def compliance(place="turn", index=0, encoder_is_at_output=True):
    return JointCompliance(place, index, encoder_is_at_output, typical=0.02, highest=0.2)


def two_masses(stiffness, command_rad, time_s, encoder_is_at_output):
    """Integrate rotor and wheel with a spring between, and a loop that closes at one of them."""
    spring_damping = 2 * DAMPING_RATIO * np.sqrt(stiffness * gear_inertia_kgm2(flywheel(), 0))

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
    near = 1e-4 if isinstance(effect, JointCompliance) else 1e-3
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
    coupling = JointCoupling("elbow", 2, "lift", 1, typical_ratio=0.05)
    command = np.tile((0.0, 0.3, 0.0), (2000, 1))
    alone, coupled = simulate(robot, (coupling,), [[0.0], [0.1]], command, [0.0, 0.3, 0.0])[:, :, -1]
    data_load_Nm = 10 * (0.0 - alone[2])  # torque with which the loop of the elbow carries the elbow
    assert coupled[1] - alone[1] == pytest.approx(0.1 * data_load_Nm / 20, rel=0.1)


ANGLES_RAD = np.linspace(-4, 4, 401)[None, :]


def smooth_size(seed):
    effect = SmoothPeriodicError("a", 2e-3)
    widths = np.array([size.prior_std for size in effect.sizes])
    return effect, np.random.default_rng(seed).normal(0, widths)[None, :]


def test_an_error_of_one_order_repeats_that_often_in_a_turn():
    effect = PeriodicError("a", 5, 1e-3)
    size = np.array([[3e-3, -4e-3]])
    error_rad = effect.encode(size, ANGLES_RAD) - ANGLES_RAD
    later_rad = effect.encode(size, ANGLES_RAD + 2 * np.pi / 5) - ANGLES_RAD - 2 * np.pi / 5
    np.testing.assert_allclose(error_rad, later_rad, atol=1e-12)
    assert np.abs(error_rad).max() == pytest.approx(5e-3, rel=1e-3)
    assert effect.describe(size[0]) == "5 mrad with 5 periods a turn, phase -0.93 rad"


@pytest.mark.parametrize("order", [1, 2, 48, 256])
def test_decode_inverts_encode_at_the_bound(order):
    effect = PeriodicError("a", order, 1e-3)
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
    orders = ((PeriodicError("a", k + 1, 1e-3), size[:, 2 * k : 2 * k + 2]) for k in range(48))
    single = sum(one.encode(own, ANGLES_RAD) - ANGLES_RAD for one, own in orders)
    np.testing.assert_allclose(effect.encode(size, ANGLES_RAD) - ANGLES_RAD, single, atol=1e-14)


@pytest.mark.parametrize("effect", [PeriodicError("a", 3, 1e-3), SmoothPeriodicError("a", 1e-3)])
def test_a_size_of_zero_changes_no_bit(effect):
    size = np.zeros((1, len(effect.sizes)))
    for job in (effect.encode, effect.decode):
        np.testing.assert_array_equal(job(size, ANGLES_RAD), ANGLES_RAD)
