"""Effects of friction, actuation, command, sensors and torques against laws written here; nominal drives."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from helpers import pendulum
from simgap.common.errors import RobotError
from simgap.effects import forces
from simgap.effects.actuation import (
    BackEmf,
    DampingGain,
    DeadZone,
    GainError,
    LeakyIntegral,
    SupplySag,
    TorqueConstant,
    TorqueLimit,
)
from simgap.effects.command import (
    AccelerationLimit,
    ClampHigh,
    ClampLow,
    CommandDelay,
    EncoderScale,
    JointZero,
    MeasurementDelay,
    VelocityLimit,
)
from simgap.effects.inertia import Armature
from simgap.logs import Signal
from simgap.patch.patch import make_patch
from simgap.robot import ControlMode

TIME_s = np.arange(0, 2, 0.01)

LINK_kgm2 = pendulum.MASS_kg * pendulum.LENGTH_m**2


def level(mode=ControlMode.TORQUE, dry_Nm=0.0, limit_Nm=np.inf):
    """Make a pendulum without gravity and damping, with a fine step."""
    steps = {"step_s": 0.0005, "period_s": 0.0005, "is_level": True}
    return pendulum.pendulum(mode, damping=0.0, dry_Nm=dry_Nm, limit_Nm=limit_Nm, **steps)


def held(command, **others):
    """Make a log with a constant command that starts at 0."""
    return pendulum.motion(TIME_s, 0 * TIME_s, np.full(TIME_s.size, command), **others)


def exact(torque, inertia_kgm2=pendulum.INERTIA_kgm2):
    """Integrate the level pendulum from rest under a torque of time, angle and speed."""

    def slope(t, y):
        return [y[1], torque(t, y[0], y[1]) / inertia_kgm2]

    found = solve_ivp(slope, (0, TIME_s[-1]), [0.0, 0.0], t_eval=TIME_s, rtol=1e-8, atol=1e-10, max_step=0.01)
    return np.asarray(found.y[0])


@pytest.mark.parametrize(
    ("kind", "size", "torque"),
    [
        (forces.ViscousFriction, [0.05], lambda t, q, v: 0.1 - 0.05 * v),
        (forces.CoulombFriction, [0.04], lambda t, q, v: 0.1 - 0.04),
        (forces.StribeckFriction, [0.05, 2.0], lambda t, q, v: 0.1 - 0.05 * np.exp(-((v / 2.0) ** 2))),
        (forces.AsymmetricFriction, [0.04], lambda t, q, v: 0.1 - 0.04),
        (forces.AsymmetricFriction, [-0.04], lambda t, q, v: 0.1),
        (forces.ConstantTorque, [0.03], lambda t, q, v: 0.13),
        (forces.Spring, [0.5, 0.02], lambda t, q, v: 0.12 - 0.5 * q),
        (forces.PeriodicTorque, [0.02, 0.03], lambda t, q, v: 0.1 + 0.02 * np.cos(q) + 0.03 * np.sin(q)),
        (forces.PositionTorque, [0.02, -0.05], lambda t, q, v: 0.1 + 0.02 * np.cos(q) - 0.05 * np.sin(q)),
        (TorqueConstant, [0.3], lambda t, q, v: 0.13),
        (TorqueLimit, [20.0], lambda t, q, v: 0.05),
        (BackEmf, [0.1], lambda t, q, v: min(0.1, 0.2 * max(1 - 0.1 * v, 0.0))),
    ],
)
def test_a_constant_motor_torque_moves_the_joint_as_the_law_says(kind, size, torque):
    robot = level(limit_Nm=0.2)
    found = pendulum.simulated(robot, held(0.1), (pendulum.at_swing(kind, robot), size))
    law = exact(torque)
    assert np.abs(found - law).max() < 2e-3 * np.abs(law).max()


def test_a_spring_may_be_weaker_than_that_of_the_model_but_does_not_push_away():
    stiffness, _ = pendulum.at_swing(forces.Spring, level(), stiffness_Nm_rad=0.1).sizes
    assert stiffness.low == -0.1


def test_a_spring_tells_where_it_is_slack():
    spring = pendulum.at_swing(forces.Spring, level(), low_rad=0.2, high_rad=0.6)
    told = spring.describe(np.array([2.0, 0.4]))
    assert told == "stiffness_Nm_rad = 2, offset_Nm = 0.4 (slack at 0.6 rad)"


@pytest.mark.parametrize(
    ("kind", "size", "motor_Nm", "more_kgm2"),
    [
        (forces.LoadFriction, 0.3, 0.1, 0.3 * LINK_kgm2),  # of the link and not of the rotor
        (Armature, 0.5 * pendulum.ARMATURE_kgm2, 0.1, 0.5 * pendulum.ARMATURE_kgm2),
        (forces.TemperatureFriction, 0.004, 0.06, 0.0),  # it counts from the hottest temperature
    ],
)
def test_load_friction_armature_and_cold_friction_slow_a_joint_as_the_law_says(
    kind, size, motor_Nm, more_kgm2
):
    robot, heat = level(), Signal(TIME_s, np.full(TIME_s.size, 30.0))
    found = pendulum.simulated(robot, held(0.1, temperature=heat), (pendulum.at_swing(kind, robot), [size]))
    law = exact(lambda t, q, v: motor_Nm, pendulum.INERTIA_kgm2 + more_kgm2)
    assert np.abs(found - law).max() < 2e-3 * np.abs(law).max()


def test_stribeck_friction_holds_what_coulomb_friction_lets_go():
    robot = level(dry_Nm=0.05)
    effect = pendulum.at_swing(forces.StribeckFriction, robot)
    assert np.abs(pendulum.simulated(robot, held(0.09), (effect, [0.05, 0.1])))[-1] < 1e-3
    assert pendulum.simulated(robot, held(0.11), (effect, [0.05, 0.1]))[-1] > 1.0


@pytest.mark.parametrize(
    ("kind", "size", "torque"),
    [
        (GainError, [0.5], lambda t, q, v: 1.5 * (4.0 * (0.2 - q) - 0.1 * v)),
        (DampingGain, [-0.05], lambda t, q, v: np.clip(4.0 * (0.2 - q) - 0.05 * v, -0.2, 0.2)),
        (DampingGain, [0.1], lambda t, q, v: np.clip(4.0 * (0.2 - q) - 0.1 * v, -0.2, 0.2) - 0.1 * v),
        (TorqueConstant, [-0.4], lambda t, q, v: 0.6 * np.clip(4.0 * (0.2 - q) - 0.1 * v, -0.5, 0.5)),
        (TorqueLimit, [5.0], lambda t, q, v: np.clip(4.0 * (0.2 - q) - 0.1 * v, -0.2, 0.2)),
        (BackEmf, [0.2], lambda t, q, v: np.clip(4.0 * (0.2 - q) - 0.1 * v, -0.2 - 0.04 * v, 0.2 - 0.04 * v)),
        (DeadZone, [0.05], lambda t, q, v: 4.0 * np.sign(0.2 - q) * max(abs(0.2 - q) - 0.05, 0.0) - 0.1 * v),
    ],
)
def test_a_position_loop_moves_as_the_law_says(kind, size, torque):
    limit_Nm = {TorqueConstant: 0.5, BackEmf: 0.2, DampingGain: 0.2}.get(kind, np.inf)
    robot = level(ControlMode.POSITION, limit_Nm=limit_Nm)
    found = pendulum.simulated(robot, held(0.2), (pendulum.at_swing(kind, robot), size))
    assert np.abs(found - exact(torque)).max() < 3e-3


@pytest.mark.parametrize(
    ("kind", "size", "bound_rad"),
    [
        (forces.Spring, [0.5, 0.1], 5e-5),
        (forces.PositionTorque, [0.2, 0.1], 5e-5),
        (forces.StribeckFriction, [0.1, 0.3], 1.5e-4),
        (DeadZone, [0.02], 4e-4),
    ],
)
def test_an_effect_acts_as_the_motion_is_in_the_middle_of_a_control_period(kind, size, bound_rad):
    time_s = np.arange(0.0, 4.0, 0.01)
    log = pendulum.motion(time_s, 0.0 * time_s, pendulum.waves(time_s, seed=5))

    def move(step_s, period_s):
        robot = pendulum.pendulum(limit_Nm=1.5, step_s=step_s, period_s=period_s)
        return pendulum.simulated(robot, log, (pendulum.at_swing(kind, robot), size))

    error = move(0.001, 0.005) - move(0.0001, 0.0001)
    assert np.mean(np.abs(error)) < bound_rad  # at its beginning: 331, 81, 265 and 1,505 urad


def test_a_leaky_integral_agrees_with_its_differential_equation():
    robot = level(ControlMode.POSITION)
    found = pendulum.simulated(robot, held(0.2), (pendulum.at_swing(LeakyIntegral, robot), [2.0, 0.5]))

    def slope(_, y):
        error = 0.2 - y[0]
        torque = 4.0 * (error + 2.0 * y[2]) - 0.1 * y[1]
        return [y[1], torque / pendulum.INERTIA_kgm2, error - 0.5 * y[2]]

    law = solve_ivp(slope, (0, TIME_s[-1]), [0.0] * 3, t_eval=TIME_s, rtol=1e-8, atol=1e-10).y[0]
    assert np.abs(found - law).max() < 3e-3


def test_a_sagging_supply_lowers_gains_by_the_torque_in_use():
    robot = level(ControlMode.POSITION)
    effect = SupplySag.of(robot, {"swing": pendulum.scales(torque_Nm=1.0)})
    found = pendulum.simulated(robot, held(0.1), (effect, [0.5]))

    def torque(_, q, v):
        wanted = 4.0 * (0.1 - q) - 0.1 * v
        return wanted / (1 + 0.5 * abs(wanted))  # torque = (1 - 0.5 |torque|) wanted

    assert np.abs(found - exact(torque)).max() < 1e-3


def test_a_supply_falls_by_no_more_than_twice_what_its_voltage_shows():
    log = pendulum.motion(TIME_s, 0 * TIME_s, 0 * TIME_s)
    volts = np.where(TIME_s < 0.8 * TIME_s[-1], 12.0, 10.8)
    with_voltage = pendulum.with_signals(log, voltage=volts)
    for logs, high in ([], 1.0), ([log], 1.0), ([with_voltage], 0.2):
        (size,) = SupplySag.of(pendulum.pendulum(), {"swing": pendulum.scales(torque_Nm=1.0)}, logs).sizes
        assert size.high == pytest.approx(high)


def test_a_delayed_command_is_an_earlier_command():
    robot = pendulum.pendulum()
    command = pendulum.waves(TIME_s, 4)
    log = pendulum.motion(TIME_s, 0 * TIME_s, command)
    for delay_s in (0.02, 0.0230, 0.0461):
        moved = replace(log.joints["swing"], command=Signal(TIME_s + delay_s, command))
        found = pendulum.simulated(robot, log, (pendulum.at_swing(CommandDelay, robot), [delay_s]))
        assert np.abs(found - pendulum.simulated(robot, replace(log, joints={"swing": moved}))).max() < 1e-4


def test_a_measurement_delay_shifts_the_samples():
    robot = pendulum.pendulum()
    log = pendulum.motion(TIME_s, 0 * TIME_s, pendulum.waves(TIME_s, 4))
    plain = pendulum.simulated(robot, log)
    for delay_s, shift in ((0.03, 3), (-0.02, -2)):
        shown = pendulum.simulated(robot, log, (pendulum.at_swing(MeasurementDelay, robot), [delay_s]))
        inside = slice(5, -5)
        assert np.abs(shown[inside] - np.roll(plain, shift)[inside]).max() < 1e-12


def test_encoder_errors_are_seen_and_fed_back():
    robot = level(ControlMode.POSITION)
    position = np.full(TIME_s.size, 0.1)
    log = pendulum.motion(TIME_s, position, position)
    for kind, size in ((JointZero, 0.03), (EncoderScale, 0.05)):
        effect = pendulum.at_swing(kind, robot)
        shown = pendulum.simulated(robot, log, (effect, [size]))
        assert shown == pytest.approx(position, abs=1e-12)  # the loop holds what the encoder shows
        sizes = np.array([[size]])
        assert effect.decode(sizes, effect.encode(sizes, position[None])) == pytest.approx(position[None])


def test_a_servo_closes_its_loop_on_the_scale_of_its_encoder():
    robot = level(ControlMode.POSITION)
    (joint,) = robot.joints

    def law(scale):
        kp, kd = joint.kp_Nm_rad, joint.kd_Nms_rad
        return scale * exact(lambda t, q, v: kp * (0.1 - scale * q) - kd * scale * v)

    scale = pendulum.at_swing(EncoderScale, robot)
    shown, plain = (pendulum.simulated(robot, held(0.1), (scale, [size])) for size in (0.08, 0.0))
    expected = law(1.08) - law(1.0)
    assert np.abs(shown - plain - expected).max() < 0.02 * np.abs(expected).max()


def shaped(kind, size, command):
    """Shape a command of one simulation."""
    effect = pendulum.at_swing(kind, pendulum.pendulum())
    return effect.shape_command(np.array([[size]]), command[None], 0.01)[0]


@pytest.mark.parametrize("speed_rad_s", [0.5, 30.0, 300.0])
def test_a_velocity_limit_is_the_mean_of_a_ramp_in_each_control_period(speed_rad_s):
    found = shaped(VelocityLimit, 1 / speed_rad_s, np.where(TIME_s > 0.095, 0.403, 0.0))
    fine_s = TIME_s[:, None] + 0.01 * (np.arange(1000) + 0.5) / 1000
    ramp = np.clip(speed_rad_s * (fine_s - 0.1), 0.0, 0.403)
    assert found == pytest.approx(ramp.mean(axis=1), abs=1e-6)


def test_an_acceleration_limit_follows_a_step_with_a_triangle_of_speed_and_does_not_overshoot():
    found = shaped(AccelerationLimit, 1 / 2.0, np.where(TIME_s > 0.005, 0.5, 0.0))
    assert found.max() <= 0.5 + 1e-12
    assert found[-1] == pytest.approx(0.5, abs=1e-6)
    assert np.abs(np.diff(found, 2)).max() <= 2.0 * 0.01**2 + 1e-12
    # half of the way after sqrt(d/a), all of it after twice that time
    assert np.interp(0.25, found, TIME_s) == pytest.approx(np.sqrt(0.5 / 2.0), abs=0.02)
    assert np.interp(0.495, found, TIME_s) == pytest.approx(1.0 - np.sqrt(2 * 0.005 / 2.0), abs=0.03)


def test_a_clamp_cuts_the_commanded_range_at_one_end():
    command = np.sin(5 * TIME_s)
    assert np.array_equal(shaped(ClampHigh, 0.2, command), np.minimum(command, 0.8))
    assert np.array_equal(shaped(ClampLow, 0.3, command), np.maximum(command, -0.7))


MOTOR = 'motorconst="0.05" resistance="2" gear="20"'
SERVO = '<default><default class="servo"><dcmotor motorconst="0.05" resistance="2"/></default></default>'
STEP_S = 0.0005


def read(folder, attributes, mode, more="", actuator="dcmotor", defaults=""):
    """Read the pendulum with a DC motor."""
    xml = pendulum.pendulum(damping=0.01).model_xml.replace("<worldbody>", f"{defaults}<worldbody>")
    drive = f'<actuator><{actuator} name="motor" joint="swing" {attributes}/></actuator></mujoco>'
    return pendulum.read(folder, xml.replace("</mujoco>", drive), mode, STEP_S, more)


def by_mujoco(text, command, scale=1.0):
    """Return the positions of a model at 1 kHz under a command, (n,)."""
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep, model.opt.integrator = STEP_S, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.dof_solimp[:] = (0.9999, 0.9999, 0.001, 0.5, 2.0)
    model.dof_solref[:] = (2 * STEP_S, 1.0)
    data = mujoco.MjData(model)
    shown = []
    for one in command:
        shown.append(data.qpos[0])
        data.ctrl[:] = scale * one
        mujoco.mj_step(model, data)
    return np.array(shown)


@pytest.mark.parametrize(
    ("attributes", "mode", "scale", "expected"),
    [
        (MOTOR, "voltage", 1.0, (0.5, 0.5)),
        ('class="servo" gear="20"', "voltage", 1.0, (0.5, 0.5)),
        (f'{MOTOR} saturation="0.02"', "voltage", 1.0, (0.5, 0.5)),
        (f'{MOTOR} armature="1e-5" damping="1e-5"', "voltage", 1.0, (0.5, 0.5)),
        (f'{MOTOR} input="pos" controller="0.01 0 0.0003"', "position", 20.0, (4.0, 0.12)),
    ],
)
def test_the_engine_moves_as_the_motor_of_mujoco(attributes, mode, scale, expected, tmp_path):
    robot = read(tmp_path, attributes, mode, defaults=SERVO)
    joint = robot.joints[0]
    assert (joint.kp_Nm_rad, joint.kd_Nms_rad) == pytest.approx(expected)
    time_s = STEP_S * np.arange(4000)
    command = pendulum.waves(time_s, 3)
    engine = pendulum.simulated(robot, pendulum.motion(time_s, 0.0 * time_s, command))
    native = by_mujoco(robot.model_xml, command, scale)
    assert np.ptp(native) > 0.2
    assert engine == pytest.approx(native, abs=2e-3)  # half a step of the command, and of the damping
    patched = by_mujoco(make_patch(robot, [], []).model_xml, command, scale)
    assert patched == pytest.approx(native, abs=2e-3)


def test_the_constants_of_a_motor_are_those_at_the_joint(tmp_path):
    joint = read(tmp_path, f'{MOTOR} saturation="0.1"', "current").joints[0]
    assert joint.mode is ControlMode.CURRENT
    assert joint.torque_constant_Nm_A == pytest.approx(1.0)
    assert joint.torque_limit_Nm == pytest.approx(2.0)
    joint = read(tmp_path, MOTOR, "position", "kp_Nm_rad = 3.0").joints[0]
    assert (joint.kp_Nm_rad, joint.kd_Nms_rad) == pytest.approx((3.0, 0.5))


@pytest.mark.parametrize(
    ("said", "given"),
    [
        (r"actuator: 'motor' has dynamics of its own", (f'{MOTOR} inductance="0.001"', "voltage")),
        (r"dynamics of its own \(thermal\); a diagnosis lacks them", (f'{MOTOR} thermal="1 1 1"', "voltage")),
        (r"dynamics of its own \(lugre\)", (f'{MOTOR} lugre="100 1 .1 .2 .01"', "voltage")),
        (r"dynamics of its own \(cogging\)", (f'{MOTOR} cogging="0.01 6 0"', "voltage")),
        ("an integral gain or slewmax", (f'{MOTOR} input="pos" controller="1 1 0"', "position")),
        ("an integral gain or slewmax", (f'{MOTOR} input="pos" controller="1 0 0 5"', "position")),
        ("a largest voltage .* saturation", (f'{MOTOR} input="pos" controller="1 0 0 0 0 12"', "position")),
        ("so set kp to 0", (f'{MOTOR} input="vel" controller="1 0 1"', "velocity")),
        ("joints.swing.kp_Nm_rad: is 0 or missing, and the model has no gain", (MOTOR, "position")),
        ("joints.swing.kd_Nms_rad: is 0 or missing, and the model has no gain", (MOTOR, "velocity")),
        ("kp_Nm_rad: has no meaning in the mode voltage; remove it", (MOTOR, "voltage", "kp_Nm_rad = 3.0")),
        ("mode: is voltage, and the model has no <dcmotor> at", ('gear="2"', "voltage", "", "motor")),
        (
            "'motor' has a delay of its own; a diagnosis looks for delays",
            ('kp="4" delay="0.01" nsample="5"', "position", "", "position"),
        ),
        ("has dynamics of its own", ('kp="4" kv="0.1" timeconst="0.05"', "position", "", "position")),
    ],
)
def test_a_drive_that_no_diagnosis_has_is_refused_in_words(said, given, tmp_path):
    with pytest.raises(RobotError, match=said):
        read(tmp_path, *given)
