"""Effects of friction, gears, motors and cables on a joint at steady speed, against their formulas."""

from functools import cache

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from helpers.marks import slow_but
from sim.effects import gears, joints
from sim.effects.effect import Effect
from sim.effects.environment import COLD_C, Ambient
from sim.mujoco_settings import BUS_V, GAINS
from tests.sim import lab
from tests.sim.effects import bench

TIMES = pytest.mark.parametrize("times", slow_but([0.5, 2.0], 2.0))
JOINTS = pytest.mark.parametrize("joint", slow_but([Joint.AZIMUTH, Joint.TURRET], Joint.TURRET))


@cache
def turn_nominal(joint: Joint, speed: float = 1.0, seconds: float = 2.5) -> bench.TurnRecord:
    return bench.turn_joint(joint, speed=speed, seconds=seconds)


def added_torque_Nm(joint: Joint, *effects: Effect, speed: float = 1.0, seconds: float = 2.5) -> float:
    """Return the torque that an effect adds, from the current."""
    with_it = bench.turn_joint(joint, *effects, speed=speed, seconds=seconds)
    found = with_it.steady_A() - turn_nominal(joint, speed, seconds).steady_A()
    return found * float(bench.TORQUE_CONSTANT_NM_A[joint])


@TIMES
@JOINTS
def test_coulomb_friction_raises_the_moving_current_by_its_torque_over_the_constant(joint, times):
    assert added_torque_Nm(joint, gears.CoulombFriction(joint, 20.0 * times)) == pytest.approx(
        20.0 * times, rel=1e-3
    )


@TIMES
@pytest.mark.parametrize(("direction", "speed"), [("positive", 1.0), ("negative", -1.0)])
def test_asymmetric_friction_costs_its_torque_in_its_direction_and_nothing_in_the_other(
    direction, speed, times
):
    joint = Joint.AZIMUTH
    effect = gears.AsymmetricFriction(joint, direction, 20.0 * times)
    assert added_torque_Nm(joint, effect, speed=speed) * speed == pytest.approx(20.0 * times, rel=1e-3)
    assert added_torque_Nm(joint, effect, speed=-speed) == pytest.approx(0.0, abs=0.01)


@TIMES
@JOINTS
def test_friction_of_an_output_is_paid_by_the_motor(joint, times):
    # the outer arm swings for a while on the springs of the links
    costs_Nm = added_torque_Nm(joint, gears.OutputFriction(joint, 5.0 * times), seconds=5.0)
    assert costs_Nm == pytest.approx(5.0 * times, rel=5e-3)


@pytest.mark.parametrize("speed", slow_but([0.5, 1.0], 0.5))
@TIMES
def test_viscous_friction_costs_its_damping_times_the_speed(speed, times):
    joint = Joint.AZIMUTH
    expected = 300.0 * times * speed * bench.SPEED_RAD_S[joint]
    assert added_torque_Nm(joint, gears.ViscousFriction(joint, 300.0 * times), speed=speed) == pytest.approx(
        expected, rel=0.02
    )


@pytest.mark.parametrize("speed", slow_but([0.1, 0.5], 0.1))
@TIMES
def test_stribeck_friction_falls_with_the_speed(speed, times):
    joint, knee = Joint.AZIMUTH, 0.01
    expected = 20.0 * times * np.exp(-((speed * bench.SPEED_RAD_S[joint] / knee) ** 2))
    assert added_torque_Nm(
        joint, gears.StribeckFriction(joint, 20.0 * times, knee), speed=speed
    ) == pytest.approx(expected, rel=0.02)


@cache
def gravity_Nm(joint: Joint) -> float:
    """Return half the difference of the torques in both directions, from currents of the nominal arm."""
    up, down = (turn_nominal(joint, speed).steady_A() for speed in (1.0, -1.0))
    return -0.5 * (up + down) * float(bench.TORQUE_CONSTANT_NM_A[joint])


def gear_load_Nm(joint: Joint, way: float) -> float:
    """Return the torque in a gear that turns its output in this direction: gravity and output friction."""
    return abs(gravity_Nm(joint) - way * lab.OUTPUT_FRICTION_NM[joint])


@TIMES
@pytest.mark.parametrize("speed", [1.0, -1.0])
def test_load_dependent_friction_is_a_share_of_what_the_gear_carries(speed, times):
    joint = Joint.ELEVATION
    assert abs(gravity_Nm(joint)) > 100.0
    found = added_torque_Nm(joint, gears.LoadFriction(joint, 0.1 * times), speed=speed) * speed
    assert found == pytest.approx(0.1 * times * gear_load_Nm(joint, speed), rel=0.04)


@pytest.mark.parametrize("factor", slow_but([0.95, 0.8], 0.8))
def test_a_gear_of_less_efficiency_costs_more_against_the_load_than_with_it(factor):
    joint = Joint.ELEVATION
    helps = np.sign(gravity_Nm(joint))
    against = added_torque_Nm(joint, gears.GearEfficiency(joint, factor), speed=-helps) * -helps
    with_it = added_torque_Nm(joint, gears.GearEfficiency(joint, factor), speed=helps) * helps
    assert against == pytest.approx((1 / factor - 1) * gear_load_Nm(joint, -helps), rel=0.04)
    assert with_it == pytest.approx((1 - factor) * gear_load_Nm(joint, helps), rel=0.04)


@pytest.mark.parametrize("factor", slow_but([0.8, 1.25], 0.8))
def test_a_motor_of_another_constant_draws_another_current_for_the_same_torque(factor):
    """Added friction loads the motor."""
    joint, other = Joint.AZIMUTH, joints.MotorConstant(Joint.AZIMUTH, factor)
    rubs = gears.CoulombFriction(joint, 20.0)
    more_A = bench.turn_joint(joint, other, rubs).steady_A() - bench.turn_joint(joint, other).steady_A()
    assert more_A == pytest.approx(20.0 / (factor * bench.TORQUE_CONSTANT_NM_A[joint]), rel=1e-3)


@pytest.mark.parametrize("factor", slow_but([0.7, 1.3], 1.3))
def test_in_the_cold_friction_is_a_factor_more_and_when_warm_it_is_not(factor):
    joint = Joint.AZIMUTH
    effect = gears.ColdFriction(joint, factor)
    assert added_torque_Nm(joint, effect) == 0.0
    cold_Nm = bench.build_arm(Ambient(COLD_C))[0].built_friction()[0][joint]
    viscous = bench.build_arm(Ambient(COLD_C))[0].built_friction()[1][joint] * bench.SPEED_RAD_S[joint]
    found = added_torque_Nm(joint, Ambient(COLD_C), effect) - added_torque_Nm(joint, Ambient(COLD_C))
    assert found == pytest.approx((factor - 1.0) * (cold_Nm + viscous), rel=0.02)


@pytest.mark.parametrize("delay_s", slow_but([0.03, 0.06], 0.03))
def test_a_joint_whose_set_points_come_late_is_behind_by_its_speed_times_the_delay(delay_s):
    joint = Joint.AZIMUTH
    late = bench.turn_joint(joint, joints.CommandDelay(joint, delay_s))
    behind = turn_nominal(joint).motor_rad[-64:] - late.motor_rad[-64:]
    assert behind.mean() == pytest.approx(bench.SPEED_RAD_S[joint] * delay_s, rel=0.02)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_the_gain_of_a_controller_is_what_it_answers_an_error_with(factor):
    answers = []
    for effects in ((), (joints.ServoGain(Joint.ELBOW, factor),)):
        plant, _ = bench.build_arm(*effects)
        bench.set_angles(plant, lab.READY_RAD)
        plant.data.ctrl[0::2] = lab.READY_RAD + 1e-5
        answers.append(bench.mujoco.mj_forward(plant.model, plant.data) or plant.data.actuator_force.copy())
    np.testing.assert_allclose(answers[1] / answers[0], [1, 1, factor, 1, 1], rtol=1e-9)


def test_the_bus_sags_by_its_resistance_times_all_currents_and_the_gains_with_it():
    effect = joints.BusSag(2.0)
    plant, hardware = bench.build_arm(effect)
    drawn = plant.model.actuator_gainprm[plant.at.actuators, GAINS].copy()
    plant.data.actuator_force[:] = [228.6, -114.3, 0.0, 86.33, 0.0]
    bench.apply_cycle_effects(plant, hardware)
    share = plant.model.actuator_gainprm[plant.at.actuators, GAINS] / drawn
    np.testing.assert_allclose(share, 1.0 - 2.0 * 2.5 / BUS_V, rtol=1e-12)


@pytest.mark.parametrize("resistance_Ohm", [0.0, 1.0, 4.0, 5.5])
def test_under_a_sagging_bus_an_integral_reaches_the_current_limit_or_what_the_bus_can_drive(resistance_Ohm):
    effect, total_A = joints.BusSag(resistance_Ohm), 5.0
    plant, hardware = bench.build_arm(effect)
    plant.data.actuator_force[:] = [total_A * 228.6, 0.0, 0.0, 0.0, 0.0]
    bench.apply_cycle_effects(plant, hardware)
    plant.data.act[:] = 1.0
    bench.mujoco.mj_step(plant.model, plant.data)  # limits the integral
    held_Nm = plant.data.act * plant.model.actuator_gainprm[plant.at.actuators, GAINS][:, 1]
    through_winding_A = (BUS_V - resistance_Ohm * total_A) / np.array([2.0, 2.0, 2.0, 3.0, 3.0])
    limit_A = np.minimum([5.0, 5.0, 5.0, 3.0, 3.0], through_winding_A)
    # `Imax` has three digits
    np.testing.assert_allclose(held_Nm / bench.TORQUE_CONSTANT_NM_A, limit_A, rtol=2e-3)


@TIMES
def test_a_flex_cable_pulls_by_its_stiffness_and_drags_by_its_drag(times):
    """Turn in both directions: the drag changes sign, the spring torque does not."""
    joint, laid = Joint.TURRET, -0.5
    effect = joints.FlexCable(joint, 10.0 * times, 2.0 * times, laid, transition_rad=0.01)
    start = lab.READY_RAD.copy()
    start[joint] = 0.0
    found = [bench.turn_joint(joint, *effects, start_rad=start, back=True) for effects in ((), (effect,))]
    more = (found[1].current_A - found[0].current_A) * bench.TORQUE_CONSTANT_NM_A[joint]
    for window, way in ((slice(130, 160), 1.0), (slice(-30, None), -1.0)):
        expected = effect.stiffness_Nm_rad * (found[1].output_rad[window] - laid) + way * effect.drag_Nm
        assert more[window].mean() == pytest.approx(expected.mean(), rel=0.02)


@TIMES
def test_a_transmission_error_moves_the_output_of_a_standing_motor_by_its_wave(times):
    effect = gears.TransmissionError(Joint.ELBOW, 3e-4 * times, -2e-4 * times, turns=5)
    for angle in (0.3, 1.4):
        pose = lab.LEFT_RAD.copy()
        pose[Joint.ELBOW] = angle
        output = []
        for effects in ((), (effect,)):
            plant, hardware = bench.build_arm(*effects, calm=True)
            plant.place(
                pose, 2.0, lambda plant=plant, hardware=hardware: bench.apply_cycle_effects(plant, hardware)
            )
            output.append(plant.output_rad()[Joint.ELBOW])
        expected = times * (3e-4 * np.cos(5 * angle) - 2e-4 * np.sin(5 * angle))
        assert output[1] - output[0] == pytest.approx(expected, rel=3e-3, abs=1e-7)


@TIMES
def test_a_gear_with_hysteresis_comes_back_short_by_its_friction_over_its_stiffness(times):
    """Load with 150 N m and release slowly, without gravity: friction of gear and output holds the rest."""
    joint, twist = Joint.ELBOW, []
    stiff = [joints.GearStiffness(other, 1.0) for other in Joint]
    for effects in (stiff, [*stiff, gears.GearHysteresis(joint, 10.0 * times)]):
        plant, _ = bench.build_arm(*effects)
        plant.model.opt.gravity[:] = 0.0
        plant.place(lab.STRAIGHT_RAD, 0.5)
        for share in (*np.linspace(0, 1, 128), *np.linspace(1, 0, 256), *np.zeros(64)):
            plant.data.qfrc_applied[plant.at.gear[joint]] = 150.0 * share
            plant.step()
        twist.append(float(plant.data.qpos[plant.at.gear[joint]]))
    assert twist[1] - twist[0] == pytest.approx(10.0 * times / lab.STIFFNESS_NM_RAD[joint], rel=0.03)


@TIMES
def test_a_counterbalance_loads_the_motor_by_a_wave_once_a_turn(times):
    joint, effect = Joint.AZIMUTH, joints.Counterbalance(Joint.AZIMUTH, 10.0 * times, -20.0 * times)
    # the outer arm swings for a while on the springs of the links
    angle = turn_nominal(joint, seconds=5.0).output_rad[-64:]
    expected_Nm = -times * float(np.mean(10.0 * np.cos(angle) - 20.0 * np.sin(angle)))
    assert added_torque_Nm(joint, effect, seconds=5.0) == pytest.approx(expected_Nm, rel=0.02)


@TIMES
def test_a_coupled_output_turns_with_the_motor_of_the_joint_before(times):
    moved, other = Joint.ELEVATION, Joint.ELBOW
    plant, hardware = bench.build_arm(gears.JointCoupling(other, 2e-3 * times))
    bench.set_angles(plant, lab.READY_RAD)
    bench.apply_cycle_effects(plant, hardware)
    turned_rad = plant.disturbance.gear_rad
    np.testing.assert_allclose(
        turned_rad, np.where(np.arange(5) == other, 2e-3 * times * lab.READY_RAD[moved], 0.0)
    )
    with pytest.raises(ValueError, match="azimuth has no joint between itself and the rover"):
        gears.JointCoupling(Joint.AZIMUTH, 1e-3)
