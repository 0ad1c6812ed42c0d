"""The engine against an independent integrator: bits, starts, error of the step, stages that are off."""

import re
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from helpers.marks import slow_but
from helpers.pendulum import (
    XML,
    INERTIA_kgm2,
    LENGTH_m,
    MASS_kg,
    at_swing,
    g_m_s2,
    motion,
    pendulum,
    simulated,
    waves,
)
from helpers.real_robots import robot_path
from helpers.two_joint_arm import arm
from simgap.common.errors import RobotError
from simgap.effects.actuation import DampingGain, DeadZone, GainError
from simgap.effects.command import AccelerationLimit, CommandDelay, MeasurementDelay
from simgap.effects.effect import Effect
from simgap.effects.forces import ConstantTorque, CoulombFriction, LoadFriction, StribeckFriction
from simgap.effects.transmission import Backlash
from simgap.logs import JointLog, Motion, Signal
from simgap.residuals.residuals import residuals_by_motion
from simgap.residuals.simulation_residuals import PENALTY_rad, SimulationResiduals
from simgap.robot import ControlMode, Robot
from simgap.simulation.compiled import Models
from simgap.simulation.simulation import Engine, profiler_off
from simgap.simulation.windows import SLOPE_SAMPLES, cut_windows, held_means, keep_beginning

TIME_s = np.arange(0, 3, 0.01)


def swing(torque, time_s, q_rad=0.0):
    """Integrate the pendulum under a torque of time, angle and speed, with damping 0.02."""

    def slope(t, y):
        gravity = -MASS_kg * g_m_s2 * LENGTH_m * np.sin(y[0])
        return [y[1], (torque(t, y[0], y[1]) + gravity - 0.02 * y[1]) / INERTIA_kgm2]

    tight = {"rtol": 1e-9, "atol": 1e-11, "max_step": 0.005}
    found = solve_ivp(slope, (0, time_s[-1]), [q_rad, 0.0], t_eval=time_s, **tight)
    return np.asarray(found.y[0])


def test_the_engine_agrees_with_an_independent_integrator_to_second_order():
    exact = swing(lambda t, q, v: 4.0 * (waves(np.array([t]), 1)[0] - q) - 0.1 * v, TIME_s)
    often_s = np.arange(0, 3, 0.0005)
    command = Signal(often_s, waves(often_s + 0.00025, 1))  # held values that are right in their middle
    log = Motion("m", {"swing": JointLog(Signal(TIME_s, 0 * TIME_s), command)}, {})
    robots = [pendulum(dry_Nm=0.0, step_s=h, period_s=h) for h in (0.01, 0.005)]
    errors = [np.abs(simulated(robot, log) - exact).max() for robot in robots]
    assert errors[0] < 2e-4
    assert errors[1] < 0.3 * errors[0]


def test_a_clipped_torque_converges_to_an_independent_integrator():
    def torque(_, q, v):
        return float(np.clip(4.0 * (1.5 - q) - 0.1 * v, -0.6, 0.6))

    log = motion(TIME_s, 0 * TIME_s, np.full(TIME_s.size, 1.5))
    robots = [pendulum(dry_Nm=0.0, limit_Nm=0.6, step_s=h, period_s=h) for h in (0.001, 0.0005, 0.00025)]
    errors = [np.abs(simulated(robot, log) - swing(torque, TIME_s)).max() for robot in robots]
    assert errors[2] < 3e-3
    assert errors[2] < 0.6 * errors[1] < 0.36 * errors[0]


@pytest.mark.parametrize(
    ("mode", "command", "torque"),
    [
        (ControlMode.VELOCITY, 0.8, lambda v: 0.1 * (0.8 - v)),
        (ControlMode.TORQUE, 0.2, lambda v: 0.2),
        (ControlMode.CURRENT, 0.1, lambda v: 0.2),
    ],
)
def test_every_control_mode_has_its_law(mode, command, torque):
    log = motion(TIME_s, 0 * TIME_s, np.full(TIME_s.size, command))
    found = simulated(pendulum(mode, dry_Nm=0.0, step_s=0.0005, period_s=0.0005), log)
    assert np.abs(found - swing(lambda t, q, v: torque(v), TIME_s)).max() < 2e-3


@pytest.mark.parametrize("period_s", [0.0005, 0.01])
def test_a_motor_without_torque_lets_the_pendulum_fall(period_s):
    off = Signal(TIME_s, (TIME_s < 1.0).astype(float))
    log = motion(TIME_s, np.full(TIME_s.size, 0.5), np.full(TIME_s.size, 0.5), enabled=off)
    robot = pendulum(dry_Nm=0.0, kp=400.0, step_s=0.0005, period_s=period_s)
    found = simulated(robot, log)
    held = (TIME_s > 0.5) & (TIME_s < 1.0)
    assert np.ptp(found[held]) < 1e-4
    begin = found[TIME_s < 1.0][-1]
    free = swing(lambda t, q, v: 0.0, TIME_s[: TIME_s.size // 2], begin)
    assert np.abs(found[100 : 100 + free.size] - free).max() < 3e-3


def test_the_gain_of_a_motion_scales_the_stiffness_alone():
    log = motion(TIME_s, 0 * TIME_s, waves(TIME_s, 2), gain={"swing": 2.0})
    doubled = simulated(pendulum(kp=2.0), log)
    assert np.array_equal(doubled, simulated(pendulum(kp=4.0), replace(log, gain={})))


def test_dry_friction_holds_up_to_its_size():
    for torque_Nm, moves in ((0.095, False), (0.105, True)):
        robot = pendulum(ControlMode.TORQUE, damping=0.0, dry_Nm=0.1, is_level=True)
        found = simulated(robot, motion(TIME_s, 0 * TIME_s, np.full(TIME_s.size, torque_Nm)))
        assert (np.abs(found[-1]) > 0.05) == moves


def test_a_loaded_joint_creeps_by_less_than_half_a_milliradian_in_a_minute():
    time_s = np.arange(0, 60, 0.05)
    robot = pendulum(ControlMode.TORQUE, damping=0.0, dry_Nm=0.1, is_level=True, step_s=0.005, period_s=0.005)
    found = simulated(robot, motion(time_s, 0 * time_s, np.full(time_s.size, 0.09)))
    assert np.abs(found).max() < 5e-4  # with the defaults of MuJoCo: about 0.4 rad


def test_a_blow_up_has_a_finite_penalty_and_no_effect_on_others(capfd):
    robot = pendulum(ControlMode.TORQUE)
    log = motion(TIME_s, 0 * TIME_s, np.ones(TIME_s.size))
    model = SimulationResiduals(robot, [log], n_threads=1)
    gain = at_swing(GainError, robot)
    found = model.residuals([gain], np.array([[0.1], [1e300], [0.1]]))
    assert np.all(found[1] == PENALTY_rad)
    assert np.array_equal(found[0], found[2])
    assert np.array_equal(found[0], model.residuals([gain], np.array([[0.1]]))[0])
    capfd.readouterr()  # MuJoCo itself prints a warning


MOTIONS = [
    motion(t, 0 * t, waves(t, seed), name=f"m{seed}")
    for seed, t in ((1, np.arange(0, 1.0, 0.01)), (2, np.arange(0, 2.0, 0.01)), (3, np.arange(0, 0.5, 0.01)))
]


def candidates():
    """Make effects with all hooks, and candidates with some of them."""
    robot = pendulum()
    frictions, timing = (StribeckFriction, LoadFriction, CoulombFriction), (CommandDelay, MeasurementDelay)
    effects = [at_swing(kind, robot) for kind in (*frictions, DeadZone, AccelerationLimit, *timing)]
    typical = np.array([one.typical for effect in effects for one in effect.sizes])
    share = np.random.default_rng(5).uniform(0.2, 2.0, (7, typical.size))
    present = np.random.default_rng(6).uniform(size=(7, typical.size)) < 0.6
    return effects, share * present * typical


@pytest.mark.slow
def test_the_bits_depend_neither_on_threads_nor_on_other_candidates():
    effects, sizes = candidates()
    models = (SimulationResiduals(pendulum(), MOTIONS, n_threads=n) for n in (1, 2))
    one, two = (model.residuals(effects, sizes) for model in models)
    assert np.array_equal(one, two)
    for k in (0, 3, 6):
        alone = SimulationResiduals(pendulum(), MOTIONS, n_threads=1).residuals(effects, sizes[[k]])
        assert np.array_equal(alone[0], one[k])


def test_the_bits_of_a_motion_depend_on_no_other_motion():
    effects, sizes = candidates()
    model = SimulationResiduals(pendulum(), MOTIONS, n_threads=1)
    together = model.residuals(effects, sizes)
    for m, name in enumerate(model.motions):
        alone = model.select([name]).residuals(effects, sizes)
        assert np.array_equal(together[:, model.motion_of == m], alone)


def test_the_beginning_of_a_window_has_the_bits_of_the_whole_window():
    effects, sizes = candidates()
    windows = cut_windows(pendulum(), MOTIONS[0], None, 0.02)
    beginnings = [keep_beginning(window, pendulum().control_period_s) for window in windows]
    assert sum(one.n_ticks for one in beginnings) < 0.5 * sum(one.n_ticks for one in windows)
    models, parts = Models(pendulum()), (windows, beginnings, [*windows, *beginnings])
    whole, short, both = (Engine(models, effects, part, 1).positions(sizes) for part in parts)
    n = [window.sample_time_s[0].size for window in windows]
    first = np.concatenate([k - n[w] + np.arange(SLOPE_SAMPLES) for w, k in enumerate(np.cumsum(n))])
    assert np.array_equal(whole[:, first], short)
    assert np.array_equal(both, np.column_stack([whole, short]))


def test_each_motion_with_its_own_sizes_has_the_bits_that_it_has_with_the_same_in_all():
    effects, sizes = candidates()
    model = SimulationResiduals(pendulum(), MOTIONS, n_threads=1)
    n = len(model.motions)
    own = np.array([np.roll(sizes, k, axis=0)[:n] for k in range(2)])
    together = residuals_by_motion(model, effects, own)
    for candidate, rows in zip(own, together, strict=True):
        alike = model.residuals(effects, candidate)
        assert np.array_equal(rows, alike[model.motion_of, np.arange(rows.size)])


STEADY: list[Effect] = [
    *(at_swing(kind, pendulum()) for kind in (GainError, CommandDelay, MeasurementDelay, ConstantTorque)),
    Backlash("swing", 0, encoder_is_at_output=False, typical=0.01, highest=0.1),
]


@pytest.mark.parametrize("limit_Nm", slow_but([0.6, float("inf")], 0.6))
def test_many_periods_in_one_call_give_the_bits_of_single_ones(limit_Nm, monkeypatch, capfd):
    robot = pendulum(limit_Nm=limit_Nm, step_s=0.001, period_s=0.002)
    off = Signal(TIME_s, ((TIME_s < 0.3) | (TIME_s > 0.605)).astype(float))
    logs = [*MOTIONS, motion(TIME_s, 0.1 * TIME_s, waves(TIME_s, 4), name="m4", enabled=off)]
    model = SimulationResiduals(robot, logs, n_threads=1)
    typical = np.array([one.typical for effect in STEADY for one in effect.sizes])
    sizes = typical * np.array([[1, 1, 1, 1, 1], [0, 0, 0, 0, 0], [0, 2, -1, 0, 0], [1e300, 0, 0, 1, 0]])
    together = model.residuals(STEADY, sizes)
    monkeypatch.setattr("simgap.simulation.simulation.SPAN", 1)
    assert np.array_equal(together, model.residuals(STEADY, sizes))
    capfd.readouterr()  # MuJoCo itself prints a warning on the gain of 1e300


def test_samples_that_are_not_kept_have_no_residual():
    keep = TIME_s < 1.0
    log = motion(TIME_s, 0 * TIME_s, waves(TIME_s, 1))
    model = SimulationResiduals(pendulum(), [log], keep={("m", "swing"): keep}, n_threads=1)
    assert model.time_s.max() < 1.0


def test_windows_begin_at_measured_positions_and_speeds():
    position = 0.3 + 0.2 * TIME_s
    windows = cut_windows(pendulum(), motion(TIME_s, position, position), 1.0, 0.02)
    assert [round(window.start_s, 6) for window in windows] == [0.0, 1.0, 2.0]
    assert [window.q_rad[0] for window in windows] == pytest.approx([0.3, 0.5, 0.7])
    assert [window.v_rad_s[0] for window in windows] == pytest.approx([0.2] * 3)


def test_a_window_begins_where_a_stop_left_the_joint_and_none_after_a_short_stretch_without_samples():
    position = np.where(TIME_s < 1.0, 0.3, 0.1)
    log, stopped = motion(TIME_s, position, 0 * TIME_s), (TIME_s > 0.6) & (TIME_s < 0.99)
    windows = cut_windows(pendulum(), log, None, 0.02, {("m", "swing"): ~stopped})
    restart_s = TIME_s[TIME_s >= 0.99][0]
    assert [window.start_s for window in windows] == [0.0, restart_s]
    assert [window.measured_rad[0][-1] for window in windows] == pytest.approx([0.3, 0.1])
    kept_s = np.concatenate([window.start_s + window.sample_time_s[0] for window in windows])
    assert not np.any((kept_s > 0.6) & (kept_s < 0.99))
    log, stale = motion(TIME_s, 0 * TIME_s, 0 * TIME_s), (TIME_s > 0.6) & (TIME_s < 0.7)
    assert len(cut_windows(pendulum(), log, None, 0.02, {("m", "swing"): ~stale})) == 1


def test_a_step_between_two_periods_counts_in_proportion():
    means = held_means(Signal(np.array([0.0, 0.0125]), np.array([1.0, 3.0])), np.arange(0, 0.06, 0.01))
    assert means == pytest.approx([1.0, 2.5, 3.0, 3.0, 3.0])


def test_a_motion_without_commands_is_refused_in_one_sentence():
    log = Motion("m", {"swing": JointLog(position=Signal(TIME_s, TIME_s))}, {})
    with pytest.raises(RobotError, match="motion m: joint swing has no command"):
        SimulationResiduals(pendulum(), [log])


def test_variables_of_the_measured_motion_are_those_of_the_motion():
    position = 0.3 * np.sin(2 * TIME_s)
    model = SimulationResiduals(pendulum(), [motion(TIME_s, position, position + 1)], n_threads=1)
    t = model.time_s
    inside = (t > 0.1) & (t < t.max() - 0.1)
    assert model.explain("position") == pytest.approx(0.3 * np.sin(2 * t))
    assert model.explain("command") == pytest.approx(1 + 0.3 * np.sin(2 * t))
    assert model.explain("velocity")[inside] == pytest.approx(0.6 * np.cos(2 * t[inside]), abs=2e-3)
    q, a = 0.3 * np.sin(2 * t[inside]), -1.2 * np.sin(2 * t[inside])
    load = MASS_kg * LENGTH_m * (g_m_s2 * np.sin(q) + LENGTH_m * a)
    assert model.explain("load")[inside] == pytest.approx(load, abs=2e-3)
    assert np.isnan(model.explain("temperature")).all()


STARTS_s = np.arange(0.0, 2.0, 0.01)
NOISE_rad = 1e-4
FINE = pendulum(step_s=0.00025)


def measure(position_rad, seed):
    """Add the noise of an encoder."""
    return position_rad + NOISE_rad * np.random.default_rng(seed).standard_normal(position_rad.size)


def worst_residual(step_s, measured_rad, command):
    robot = pendulum(step_s=step_s, period_s=0.004)
    model = SimulationResiduals(robot, [motion(STARTS_s, measured_rad, command)], n_threads=1)
    return float(np.abs(model.residuals([], np.zeros((1, 0)))).max())


@pytest.mark.parametrize("seed", range(3))
def test_a_joint_that_is_pulled_from_rest_starts_at_rest(seed):
    command = np.full(STARTS_s.size, 0.5)
    truth = simulated(FINE, motion(STARTS_s, 0 * STARTS_s, command))
    speed_rad_s = truth[4] / STARTS_s[4]
    assert speed_rad_s > 0.5  # the speed of its first samples
    assert worst_residual(0.002, measure(truth, seed), command) < 10 * NOISE_rad


@pytest.mark.parametrize("seed", range(3))
def test_a_joint_whose_log_begins_in_motion_starts_with_its_speed(seed):
    command = waves(STARTS_s, seed)
    truth = simulated(FINE, motion(STARTS_s, 0 * STARTS_s, command))
    speed_rad_s = np.gradient(truth, STARTS_s)
    begin = int(np.argmax(speed_rad_s[:100]))
    log = motion(STARTS_s[begin:], measure(truth, seed)[begin:], command[begin:])
    model = SimulationResiduals(pendulum(), [log], n_threads=1)
    assert np.abs(model.residuals([], np.zeros((1, 0)))).max() < 20 * NOISE_rad


def test_steps_that_are_too_long_for_the_motor_show_no_residual():
    command = waves(STARTS_s, 5)
    truth = simulated(FINE, motion(STARTS_s, 0 * STARTS_s, command))
    long = np.abs(simulated(pendulum(step_s=0.004, period_s=0.004), motion(STARTS_s, truth, command)) - truth)
    assert worst_residual(0.004, truth, command) < 0.2 * long.max()


@pytest.mark.parametrize("seed", slow_but(range(3), 1))
def test_a_start_that_is_measured_wrongly_leaves_nothing_in_a_fit(seed):
    command = waves(STARTS_s, seed)
    truth = simulated(FINE, motion(STARTS_s, 0 * STARTS_s, command))
    measured_rad = measure(truth, seed)
    measured_rad[:5] += 5e-3
    log = motion(STARTS_s, measured_rad, command)
    models = [SimulationResiduals(pendulum(), [log], n_threads=1, fit_starts=fit) for fit in (False, True)]
    judged, fitted = (np.abs(one.residuals([], np.zeros((1, 0)))) for one in models)
    assert judged[0, 5:15].max() > 10 * NOISE_rad
    assert np.median(fitted[0, 5:]) < 2 * NOISE_rad


IDLE = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_ISLAND


def path(model):
    """Swing all joints far, into their limits if they have some."""
    data = mujoco.MjData(model)
    found = []
    for k in range(500):
        data.qfrc_applied[:] = 5.0 * np.sin(0.02 * k + np.arange(model.nv))
        mujoco.mj_step(model, data)
        found.append(data.qpos.copy())
    return np.array(found)


def so101():
    return Robot.from_toml(robot_path("so101"))


@pytest.mark.parametrize("robot", [pendulum, arm, so101])
def test_the_stages_that_are_skipped_change_no_bit(robot):
    model = Models(robot()).compiled([]).robot.model
    assert model.opt.disableflags & IDLE == IDLE
    fast = path(model)
    model.opt.disableflags &= ~IDLE
    assert np.array_equal(fast, path(model))


@pytest.mark.parametrize("robot", [arm, so101])
def test_dry_friction_and_limits_alone_are_solved_to_a_microradian(robot):
    model = Models(robot()).compiled([]).robot.model
    assert model.opt.solver == mujoco.mjtSolver.mjSOL_PGS
    model.dof_frictionloss = np.maximum(model.dof_frictionloss, 0.5)
    found = path(model)
    model.opt.solver, model.opt.tolerance = mujoco.mjtSolver.mjSOL_NEWTON, 1e-14
    np.testing.assert_allclose(found, path(model), rtol=0.0, atol=1e-6)


def test_a_model_with_a_tendon_keeps_its_solver():
    robot = pendulum()
    model = Models(robot).compiled([Backlash("swing", 0, False, 0.01, 0.1)]).robot.model
    assert model.opt.solver == robot.model.opt.solver == mujoco.mjtSolver.mjSOL_NEWTON


def test_a_mesh_that_is_only_seen_is_not_kept_and_its_mass_counts():
    corners = "1 0 0  0 1 0  0 0 1  -1 -1 -1"
    seen = '<geom type="mesh" mesh="cover" mass="0.4" contype="0" conaffinity="0" pos="0 0 -0.1"/></body>'
    xml = XML.format(
        step=0.002, name="swing", damping=0.02, dry=0.01, armature=0.002, axis="0 1 0", arm="", mass=1.0
    )
    xml = re.sub("<inertial.*/>", "", xml).replace("</body>", seen)
    xml = xml.replace("<worldbody>", f'<asset><mesh name="cover" vertex="{corners}"/></asset><worldbody>')
    robot = replace(pendulum(), model=mujoco.MjModel.from_xml_string(xml), model_xml=xml)
    model = Models(robot).compiled([]).robot.model
    assert (robot.model.nmesh, model.nmesh) == (1, 0)
    for name in ("body_mass", "body_inertia", "body_ipos", "body_iquat"):
        assert np.array_equal(getattr(model, name), getattr(robot.model, name))


def test_the_profiler_is_off_inside_and_on_again_outside():
    mujoco.set_mjcb_time(None)  # a plant in this process has switched it off for good
    model = pendulum().model
    seconds = []
    with profiler_off():
        data = mujoco.MjData(model)
        mujoco.mj_step(model, data)
        seconds.append(data.timer[0].duration)
    mujoco.mj_step(model, data)
    seconds.append(data.timer[0].duration)
    assert seconds[0] == 0.0 < seconds[1]


def off_between(first_s, last_s):
    """Return the power of a motor that has none for some time."""
    return Signal(TIME_s, 1.0 - ((TIME_s > first_s) & (TIME_s < last_s)))


@pytest.mark.parametrize("back_emf", [0.0, 0.3])
def test_a_turntable_without_power_has_its_armature(back_emf):
    """MuJoCo takes the inertia of such a simple joint from a number that the compiler computes."""
    xml = """<mujoco><option timestep="0.005"/><worldbody><body>
        <joint name="swing" axis="0 0 1" damping="0.02" armature="0.01" springref="-57.3" stiffness="1"/>
        <inertial pos="0 0 0" mass="0.003" diaginertia="0.003 0.003 0.003"/></body></worldbody></mujoco>"""
    robot = replace(
        pendulum(), model=mujoco.MjModel.from_xml_string(xml), model_xml=xml, control_period_s=0.01
    )
    command, enabled = waves(TIME_s, 5), off_between(0.6, 1.2)
    found = simulated(
        robot,
        motion(TIME_s, 0.0 * TIME_s, command, enabled=enabled),
        (at_swing(DampingGain, robot), [back_emf]),
    )
    h, q, v, exact = 1e-4, 0.0, 0.0, []
    for k in range(round(TIME_s[-1] / h) + 1):
        exact.append(q)
        on, wanted = (one[int(k * h / 0.01 + 0.26)] for one in (enabled.value, command))  # half a step early
        v += h * (on * (4.0 * (wanted - q) - (0.1 + back_emf) * v) - (q + 1.0) - 0.02 * v) / 0.013
        q += h * v
    assert np.abs(found - np.interp(TIME_s, h * np.arange(len(exact)), exact)).max() < 0.02


def test_a_rotor_without_power_has_its_armature():
    log = motion(TIME_s, 0.0 * TIME_s, waves(TIME_s, 5), enabled=off_between(0.6, 1.2))

    def move(step_s):
        robot = pendulum(step_s=step_s, period_s=0.01, dry_Nm=0.0)
        gear = Backlash("swing", 0, False, 0.02, 0.2)
        return simulated(robot, log, (at_swing(DampingGain, robot), [0.15]), (gear, [0.02]))

    assert np.abs(move(0.002) - move(0.0001)).max() < 0.02
