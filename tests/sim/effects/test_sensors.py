"""Sensors with wrong readings."""

import numpy as np
import pytest

from fsw.config import configure
from fsw.dictionary.enums import Joint
from fsw.messages import Sensors
from sim.arms import nominal_params
from sim.effects.effect import Effect, nominal_hardware
from sim.effects.joints import ResolverBias
from sim.effects.sensors import (
    CurrentBias,
    CurrentCrosstalk,
    CurrentGain,
    EncoderScale,
    EncoderZero,
    GravityDirection,
    ResolverEccentricity,
    ResolverScale,
)
from sim.setting import World
from tests.sim import lab
from tests.sim.effects import bench

RESOLVER_LSB_RAD = nominal_hardware().resolver_step_rad
JOINTS = pytest.mark.parametrize("joint", [Joint.AZIMUTH, Joint.WRIST])
TIMES = pytest.mark.parametrize("times", [0.5, 1.0, 2.0])


def read(
    *effects: Effect, motor_rad: lab.Array = lab.LEFT_RAD, current_A: float | lab.Array = 0.0
) -> Sensors:
    """Read the sensors at these motor angles, undeflected, without noise, at these motor currents."""
    plant, hardware = bench.build_arm(*effects)
    bench.set_angles(plant, motor_rad)
    plant.data.actuator_force[:] = current_A * bench.TORQUE_CONSTANT_NM_A
    return bench.avionics(plant, hardware).sense()


@TIMES
@JOINTS
def test_a_resolver_off_its_axis_differs_from_its_encoder_by_a_wave_once_a_turn(joint, times):
    effect = ResolverEccentricity(joint, 1e-3 * times, -2e-3 * times)
    angles = np.linspace(-0.3, 5.5, 9) if joint is not Joint.AZIMUTH else np.linspace(-3.0, 1.5, 9)
    for angle in angles:
        pose = np.where(np.arange(5) == joint, angle, lab.LEFT_RAD)
        plant, hardware = bench.build_arm(effect)
        sensors = bench.avionics(bench.set_angles(plant, pose), hardware).sense()
        encoder = sensors.encoder_count * hardware.rad_per_count + hardware.counter_zero_rad
        apart = sensors.resolver_rad - encoder
        expected = times * (1e-3 * np.cos(angle) - 2e-3 * np.sin(angle))
        np.testing.assert_allclose(
            apart, np.where(np.arange(5) == joint, expected, 0.0), atol=0.6 * RESOLVER_LSB_RAD
        )


@JOINTS
def test_gain_and_bias_of_a_current_sensor_and_biases_of_a_resolver_are_in_its_readings(joint):
    here = np.arange(5) == joint
    gain, bias = (
        read(effect, current_A=1.5) for effect in (CurrentGain(joint, 1.3), CurrentBias(joint, -0.2))
    )
    np.testing.assert_allclose(gain.current_A, 1.5 * np.where(here, 1.3, 1.0))
    np.testing.assert_allclose(bias.current_A - 1.5, -0.2 * here, atol=1e-12)
    more = read(ResolverBias(joint, 2e-3), ResolverBias(joint, 1e-3)).resolver_rad - read().resolver_rad
    np.testing.assert_allclose(more, 3e-3 * here, atol=RESOLVER_LSB_RAD)
    # a lost count is not there yet when joints look for their hardstops
    assert ResolverBias.built_in
    assert not EncoderZero.built_in


def test_a_current_sensor_with_crosstalk_reads_a_share_of_the_current_of_the_joint_before():
    currents_A = np.array([1.0, 2.0, -3.0, 4.0, 5.0])
    more = read(CurrentCrosstalk(Joint.WRIST, 0.1), current_A=currents_A).current_A - currents_A
    np.testing.assert_allclose(more, [0.0, 0.0, 0.0, -0.3, 0.0], atol=1e-12)
    with pytest.raises(ValueError, match="azimuth has no joint between itself and the rover"):
        CurrentCrosstalk(Joint.AZIMUTH, 0.1)


@TIMES
@JOINTS
def test_scales_of_resolver_and_encoder_make_them_read_in_proportion_to_the_angle(joint, times):
    error = 3e-3 * times
    more = read(ResolverScale(joint, error)).resolver_rad - read().resolver_rad
    expected = error * np.where(np.arange(5) == joint, lab.LEFT_RAD, 0.0)
    np.testing.assert_allclose(more, expected, atol=RESOLVER_LSB_RAD)
    counts = read(EncoderScale(joint, error)).encoder_count - read().encoder_count
    from_zero = lab.LEFT_RAD - nominal_hardware().counter_zero_rad
    expected = expected * from_zero / lab.LEFT_RAD / nominal_hardware().rad_per_count
    np.testing.assert_allclose(counts, expected, atol=1.0)


def test_flight_software_that_knows_the_scale_of_an_encoder_has_the_right_angle():
    effect = EncoderScale(Joint.ELBOW, 2e-3)
    known = configure(effect.on_params(nominal_params())).rad_per_count
    np.testing.assert_allclose(known, effect.on_hardware(nominal_hardware()).rad_per_count, rtol=1e-12)


@TIMES
@JOINTS
def test_an_encoder_that_lost_count_reads_too_much_and_its_motor_goes_less_far(joint, times):
    offset = 3e-3 * times
    plant, hardware = bench.build_arm(EncoderZero(joint, offset))
    drawn, lost = (
        bench.avionics(*found)
        for found in (bench.build_arm(), (bench.set_angles(plant, lab.LEFT_RAD), hardware))
    )
    bench.set_angles(drawn._plant, lab.LEFT_RAD)
    counts = lost.encoder_count() - drawn.encoder_count()
    expected = offset / hardware.rad_per_count * (np.arange(5) == joint)
    np.testing.assert_allclose(counts, expected, atol=1.0)


@pytest.mark.parametrize(("axis", "sign"), [("x", -1.0), ("y", 1.0)])
@TIMES
def test_an_imu_mounted_askew_sees_gravity_turned(axis, sign, times):
    """Down is z: a rotation about x tilts it to -y, one about y to +x."""
    angle = 5e-3 * times
    g = read(GravityDirection(axis, angle)).gravity_R_m_s2
    size = np.linalg.norm(World().gravity_N_m_s2)
    leaning = 1 if axis == "x" else 0
    expected = np.zeros(3)
    expected[2], expected[leaning] = size * np.cos(angle), sign * size * np.sin(angle)
    np.testing.assert_allclose(g, expected, atol=1e-12)
