"""Motor controllers, brakes, encoders, resolvers, switches and the IMU, as flight software uses them."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from fsw.config import CYCLE_HZ, configure
from fsw.dictionary.enums import Joint
from fsw.messages import ActuatorCommand
from sim.arms import nominal_params
from sim.avionics import Avionics
from sim.effects.effect import Hardware, nominal_hardware
from sim.effects.environment import PowerLoss
from sim.frames import FLIP
from sim.plant import Plant
from sim.setting import World
from tests.sim import lab
from tests.sim.effects.bench import set_angles
from tests.tools import SWITCHES, TOOL_SWITCHES, WITH_SWITCHES, switch_index, tool_index

PARAMS = nominal_params()
CONFIG = configure(PARAMS)
ALL, NONE = np.ones(5, bool), np.zeros(5, bool)
COUNTER_ZERO_RAD = nominal_hardware().counter_zero_rad
RESOLVER_LSB_RAD = nominal_hardware().resolver_step_rad
READINGS = 2000


def avionics_of(plant: Plant, hardware: Hardware | None = None, seed: int = 5) -> Avionics:
    return Avionics(plant, hardware or nominal_hardware(), np.random.default_rng([seed, 2]))


def drive_to(motor_rad: lab.Array, **changes: lab.Array) -> ActuatorCommand:
    """Apply power, release the brakes and set the set-points to these angles."""
    count = np.rint((motor_rad - COUNTER_ZERO_RAD) / CONFIG.rad_per_count).astype(np.int64)
    return replace(
        ActuatorCommand(count, np.zeros(5), CONFIG.current_limit_A, ALL, ALL, vibrate=False), **changes
    )


@pytest.fixture
def ready() -> Plant:
    plant = lab.plant()
    plant.place(lab.READY_RAD, 0.5)
    return plant


@pytest.mark.parametrize("offset_count", [-0.49, -0.1, 0.0, 0.1, 0.49])
@pytest.mark.parametrize("zero_rad", [COUNTER_ZERO_RAD, np.array([0.3, -2.0, 1.0, -0.5, 0.1])])
def test_encoders_read_whole_counts_nearest_to_the_motor_from_a_zero_that_says_nothing(
    ready, zero_rad, offset_count
):
    whole = np.array([1000, -20000, 45000, 0, 7])
    ready.data.qpos[ready.at.motor] = zero_rad + (whole + offset_count) * CONFIG.rad_per_count
    sensors = avionics_of(ready, replace(nominal_hardware(), counter_zero_rad=zero_rad))
    np.testing.assert_array_equal(sensors.sense().encoder_count, whole)


def test_encoders_do_not_see_backlash_and_wind_up_and_resolvers_do(ready):
    before = avionics_of(ready).sense()
    ready.data.qpos[ready.at.gear] += 0.01
    after = avionics_of(ready).sense()
    np.testing.assert_array_equal(after.encoder_count, before.encoder_count)
    np.testing.assert_allclose(
        after.resolver_rad - before.resolver_rad, 0.01, rtol=0, atol=1.01 * RESOLVER_LSB_RAD
    )


def test_resolvers_read_with_16_bit_bias_and_noise(ready):
    bias = np.array([2e-3, -1e-3, 0.0, 3e-3, -4e-3])
    sensors = avionics_of(ready, replace(nominal_hardware(), resolver_bias_rad=bias))
    read = np.array([sensors.sense().resolver_rad for _ in range(READINGS)])
    steps = read * 2**16 / (2 * np.pi)
    np.testing.assert_allclose(steps, np.rint(steps), rtol=0, atol=1e-6)
    assert np.all(np.ptp(np.rint(steps), axis=0) >= 3)
    noise = np.hypot(1e-4, RESOLVER_LSB_RAD / np.sqrt(12))
    np.testing.assert_allclose(
        read.mean(axis=0), ready.output_rad() + bias, rtol=0, atol=5 * noise / READINGS**0.5
    )
    np.testing.assert_allclose(read.std(axis=0), noise, rtol=0.1)


@pytest.mark.parametrize("limit_share", [1.0, 0.3])
@pytest.mark.parametrize("side", [1, -1])
def test_the_current_limit_limits_the_torque(ready, limit_share, side):
    """Command a tenth of a radian against closed brakes, which needs the full torque of a motor."""
    sensors = avionics_of(ready)
    limit = limit_share * CONFIG.current_limit_A
    sensors.apply(drive_to(lab.READY_RAD + side * 0.1, current_limit_A=limit, brake_release=NONE))
    published_Nm = limit_share * np.array([1143.0, 1143.0, 1143.0, 259.0, 259.0])
    for _ in range(20):
        ready.step()
        np.testing.assert_allclose(ready.truth().motor_torque_Nm, side * published_Nm, rtol=1e-3)
    np.testing.assert_allclose(sensors.sense().current_A, side * limit, rtol=0, atol=0.1)


def test_motors_follow_their_set_points(ready):
    sensors = avionics_of(ready)
    sensors.apply(drive_to(lab.READY_RAD))
    lab.run(ready, 1.0, lambda _: sensors.apply(drive_to(lab.READY_RAD)))
    goal = lab.READY_RAD + 0.005
    lab.run(
        ready, 1.0, lambda amount: sensors.apply(drive_to(lab.READY_RAD + 0.005 * lab.smooth_step(amount)))
    )
    lab.run(ready, 3.0, lambda _: sensors.apply(drive_to(goal)))
    np.testing.assert_allclose(ready.motor_rad(), goal, rtol=0, atol=3e-5)


@pytest.mark.parametrize("dead", Joint)
def test_power_is_switched_for_each_motor_by_itself(ready, dead):
    sensors = avionics_of(ready)
    power = np.arange(5) != dead
    sensors.apply(drive_to(lab.READY_RAD + 0.1, power_on=power, brake_release=NONE))
    lab.run(ready, 0.1)
    np.testing.assert_array_equal(ready.truth().motor_torque_Nm != 0.0, power)


def test_a_brake_locks_75_ms_after_the_drive_that_asks_for_it(ready):
    """The delay is rounded to five cycles of 15.6 ms; until then the motors run on."""
    sensors = avionics_of(ready)
    rate = np.radians(0.5)
    way = iter(lab.READY_RAD + rate * np.arange(1, 500)[:, None] / CYCLE_HZ)

    def run_on(brakes_off: np.ndarray) -> None:
        sensors.apply(drive_to(next(way), setpoint_rate_rad_s=np.full(5, rate), brake_release=brakes_off))
        ready.step()

    for _ in range(200):
        run_on(ALL)
    assert not ready.data.eq_active[ready.at.brake].any()
    angles = [ready.motor_rad().copy()]
    for _ in range(20):
        run_on(NONE)
        angles.append(ready.motor_rad().copy())
    travel = np.diff(angles, axis=0)
    locked_after = np.argmax(np.all(np.abs(travel) < 0.05 * rate / CYCLE_HZ, axis=1))
    assert abs(locked_after / CYCLE_HZ - 0.075) <= 0.5 / CYCLE_HZ + 1e-9
    assert np.all(travel[:locked_after] > 0.5 * rate / CYCLE_HZ)
    assert np.abs(travel[locked_after:].sum(axis=0)).max() < 5e-6


def test_when_the_power_is_lost_motors_are_limp_and_brakes_fall_in_whatever_is_asked(ready):
    sensors = avionics_of(ready, PowerLoss(1.0).on_hardware(nominal_hardware()))
    ask = drive_to(lab.READY_RAD + 0.1)
    for cycle in range(2 * CYCLE_HZ):
        sensors.apply(ask)
        ready.step()
        time_s = cycle / CYCLE_HZ
        assert ready.truth().motor_torque_Nm.any() == (time_s < 1.0)
        if 0.1 < time_s < 1.0 or time_s > 1.1:
            assert (ready.data.eq_active[ready.at.brake] == (time_s > 1.0)).all()


def test_a_brake_asked_to_change_its_mind_does_what_it_was_asked_last(ready):
    sensors = avionics_of(ready)
    sensors.apply(drive_to(lab.READY_RAD, brake_release=NONE))
    lab.run(ready, 0.2, lambda _: sensors.apply(drive_to(lab.READY_RAD)))
    lab.run(ready, 0.05, lambda _: sensors.apply(drive_to(lab.READY_RAD, brake_release=NONE)))
    lab.run(ready, 0.2, lambda _: sensors.apply(drive_to(lab.READY_RAD)))
    assert not ready.data.eq_active[ready.at.brake].any()


def test_a_winding_warms_by_what_its_current_heats():
    """Hold the level arm on Earth by its motors: I squared R heats 450 or 200 J/K."""
    plant = lab.load(lab.plant(World("earth")), lab.STRAIGHT_RAD, duration_s=4.0)
    sensors = avionics_of(plant, replace(nominal_hardware(), current_noise_A=0.0))
    cold = sensors.sense().winding_C
    np.testing.assert_allclose(cold, 20.0)
    heat_J = np.zeros(5)
    resistance = np.array([2.0, 2.0, 2.0, 3.0, 3.0])
    for _ in range(20 * CYCLE_HZ):
        sensors.apply(drive_to(lab.STRAIGHT_RAD))
        plant.step()
        heat_J += sensors.sense().current_A ** 2 * resistance / CYCLE_HZ
    rise = sensors.sense().winding_C - cold
    assert rise[Joint.ELEVATION] > 0.5
    np.testing.assert_allclose(
        rise, heat_J / np.array([450.0, 450.0, 450.0, 200.0, 200.0]), rtol=0.1, atol=0.02
    )


@pytest.mark.slow
def test_a_winding_cools_without_power(ready):
    sensors = avionics_of(ready)
    sensors.apply(drive_to(lab.READY_RAD + 0.001, brake_release=NONE))
    lab.run(ready, 5.0)
    warm_K = sensors.sense().winding_C - 20.0
    sensors.apply(drive_to(lab.READY_RAD, power_on=NONE, brake_release=NONE))
    lab.run(ready, 60.0)
    left_K = warm_K * np.exp(-60.0 / np.array([900.0, 900.0, 900.0, 600.0, 600.0]))
    assert np.all(warm_K > 0.3)
    np.testing.assert_allclose(sensors.sense().winding_C - 20.0, left_K, rtol=1e-6)


@pytest.mark.parametrize("switch", SWITCHES)
def test_a_switch_closes_above_its_force_and_no_other_with_it(ready, switch):
    sensors = avionics_of(ready)
    address = ready.model.sensor(switch).adr[0]
    ready.data.sensordata[:] = 0.0
    ready.data.sensordata[address] = 1.99
    assert not sensors.sense().switch_closed.any()
    ready.data.sensordata[address] = 2.01
    np.testing.assert_array_equal(np.flatnonzero(sensors.sense().switch_closed), [switch_index(switch)])


@pytest.mark.parametrize("tool", WITH_SWITCHES)
def test_a_tool_on_a_wall_closes_the_switches_whose_pads_bear_the_load(ready, tool):
    """The wall is half a millimetre in front of the tool, and gravity pulls towards it."""
    set_angles(ready, lab.READY_RAD)
    R_WT = ready.data.site_xmat[ready.at.tools[tool_index(tool)]].reshape(3, 3)
    p_W = ready.data.site_xpos[ready.at.tools[tool_index(tool)]] + (0.1 + 0.0005) * R_WT[:, 0]

    def wall(spec: mujoco.MjSpec) -> None:
        spec.option.gravity = 2.0 * R_WT[:, 0]
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, R_WT.ravel())
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.06, 0.06], pos=p_W, quat=quat,
            contype=2, conaffinity=1,
        )  # fmt: skip

    pressed = lab.plant(edit=wall)
    pressed.place(lab.READY_RAD, 2.0)
    force_N = pad_forces_N(pressed)
    assert force_N.sum() > 20.0
    assert force_N.sum() == pytest.approx(pressed.truth().contact_force_N)
    assert set(np.flatnonzero(force_N)) <= {switch_index(switch) for switch in TOOL_SWITCHES[tool]}
    np.testing.assert_array_equal(avionics_of(pressed).sense().switch_closed, force_N > 2.0)


def pad_forces_N(plant: Plant) -> lab.Array:
    """Return the normal force on the pad of each switch, from the contacts."""
    pads = [plant.model.geom(f"{switch}_pad").id for switch in SWITCHES]
    total, force = np.zeros(len(SWITCHES)), np.zeros(6)
    for k, contact in enumerate(plant.data.contact):
        mujoco.mj_contactForce(plant.model, plant.data, k, force)
        total += force[0] * np.isin(pads, contact.geom)
    return total


@pytest.mark.parametrize(("roll_deg", "pitch_deg"), [(0, 0), (20, 0), (0, 20), (-15, 25), (0, -30)])
@pytest.mark.parametrize("scene", ["mars", "earth"])
def test_the_imu_reads_gravity_in_the_tilted_rover(scene, roll_deg, pitch_deg):
    world = lab.tilted_world(roll_deg, pitch_deg, scene)
    plant = lab.plant(world)
    sensors = avionics_of(plant)
    read = np.array([sensors.sense().gravity_R_m_s2 for _ in range(READINGS)])
    roll, pitch = np.radians(roll_deg), np.radians(pitch_deg)
    g = 3.711 if scene == "mars" else 9.81
    down = g * np.array([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)])
    np.testing.assert_allclose(read.mean(axis=0), down, rtol=0, atol=5 * 0.005 / READINGS**0.5)
    np.testing.assert_allclose(read.std(axis=0), 0.005, rtol=0.1)
    np.testing.assert_allclose(FLIP * plant.model.opt.gravity, down, rtol=0, atol=1e-12)
