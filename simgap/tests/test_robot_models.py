"""Models of real robots agree with published numbers and load the measured logs; a twin of the SO-101."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from helpers.effect_lab import motion_of
from helpers.real_robots import LOADED, LOGS, ROBOTS, robot_path
from simgap.diagnosis import diagnose
from simgap.files.robot_file import SerialFile, read_robot_file
from simgap.loading import load, read_split
from simgap.robot import Robot
from simgap.serial_arm.files import read_arm, read_mapping

PUBLISHED = {"so101": "so101/so101.xml", "kr300": "kr300/kr300.xml"}


@pytest.mark.parametrize("name", LOADED)
def test_gravity_loads_the_joints_that_it_can_move_and_no_number_counts_as_known(name):
    joints = Robot.from_toml(robot_path(name)).joints
    assert {one.name for one in joints if one.is_loaded_by_gravity} == LOADED[name]
    assert not any(one.is_known for one in joints)


def test_the_pendulum_has_the_published_mass_at_the_published_distance():
    robot = Robot.from_toml(robot_path("pendulum"))
    data = mujoco.MjData(robot.model)
    data.qpos[0] = np.pi / 2
    mujoco.mj_forward(robot.model, data)
    assert abs(data.qfrc_bias[0]) == pytest.approx(0.49 * 9.81 * 0.1)
    inertia_kgm2 = float(data.M[0]) - float(robot.model.dof_armature[0])
    assert inertia_kgm2 == pytest.approx(0.49 * 0.1**2 + 1.19e-4)


def test_the_gain_of_the_pendulum_follows_from_firmware_and_data_sheet():
    share_per_rad = 4096 / (2 * np.pi) / (256 * 885)
    servo = Robot.from_toml(robot_path("pendulum")).joint("servo")
    assert servo.kp_Nm_rad == pytest.approx(share_per_rad * 7.4 * 0.52 / 5.0, rel=1e-3)
    assert servo.torque_limit_Nm == pytest.approx(7.4 * 0.52 / 5.0, rel=1e-2)


def test_the_gain_of_the_so101_follows_from_firmware_and_torque_limit():
    for joint in Robot.from_toml(robot_path("so101")).joints:
        assert joint.kp_Nm_rad == pytest.approx(0.166 * 16 * joint.torque_limit_Nm, rel=1e-3)


def test_the_two_halves_of_the_so101_share_no_motion_and_have_all():
    parts = read_split(robot_path("so101").parent / "split.toml").parts
    assert len(parts["a"]) == len(parts["b"]) == 20
    assert len({*parts["a"], *parts["b"]}) == 40
    for part, fast in {"a": "chirp_sweep", "b": "prbs_excitation"}.items():
        assert fast in parts[part]


def test_the_ur10_points_to_its_serial_arm_and_to_mappings_of_its_poses():
    found = read_robot_file(robot_path("ur10"))
    assert isinstance(found, SerialFile)
    folder = robot_path("ur10").parent
    assert {read_mapping(folder / one).arm for one in found.poses.values()} == {"UR10"}
    assert read_arm(folder / found.serial_arm).name == "UR10"


@pytest.mark.parametrize("name", ROBOTS)
def test_every_model_says_where_its_numbers_come_from(name):
    assert "Logs" in (robot_path(name).parent / "PROVENANCE.md").read_text()


@pytest.mark.real_data
@pytest.mark.parametrize("name", PUBLISHED)
def test_gravity_and_inertia_are_those_of_the_published_model(real_data, name):
    ours = Robot.from_toml(robot_path(name)).model
    published = mujoco.MjModel.from_xml_path(str(real_data / PUBLISHED[name]))
    random = np.random.default_rng(25)
    for _ in range(20):
        q, v = random.uniform(-1.0, 1.0, (2, ours.nv))
        (bias, inertia, site), (bias0, inertia0, site0) = (_terms(one, q, v) for one in (ours, published))
        np.testing.assert_allclose(bias, bias0, atol=1e-5 * np.max(np.abs(bias0)))
        np.testing.assert_allclose(inertia, inertia0, atol=1e-5 * np.max(np.abs(inertia0)))
        np.testing.assert_allclose(site, site0, atol=1e-6)


def _terms(model, q, v):
    """Return gravity and Coriolis torques, mass matrix, and place of the last site."""
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = q, v
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    return data.qfrc_bias.copy(), full, data.site_xpos[-1].copy()


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("name", "fitted", "judged", "joints"), [("so101", 20, 20, 6), ("pendulum", 12, 4, 1), ("kr300", 1, 1, 6)]
)
def test_the_logs_load_and_are_split(real_data, name, fitted, judged, joints):
    logs = load(robot_path(name), [real_data / one for one in LOGS[name]])
    assert (len(logs.fit), len(logs.judged)) == (fitted, judged)
    for motion in logs.motions:
        assert len(motion.joints) == joints
        for one in motion.joints.values():
            assert one.position.time_s[0] < 0.01
            assert np.ptp(one.position.value) < 2 * np.pi


LIFT, ELBOW = "shoulder_lift", "elbow_flex"
MOVING = (LIFT, ELBOW)
GAIN_RATIO = {LIFT: 0.4, ELBOW: 0.15}
"""Relative change of the stiffness of the servos."""
FRICTION_PER_LOAD = np.array([0.7, 0.0])
"""Dry friction per torque that the gears carry: of gravity, and of the inertia behind them."""
REST_rad = {LIFT: 0.0, ELBOW: 0.5}
REACH_rad = {LIFT: 0.3, ELBOW: 0.4}
DURATION_s, ROW_s = 4.0, 0.02
COUNT_rad = 2 * np.pi / 4096
NOISE_rad = 0.3e-3
"""Standard deviation of a position before it is rounded to counts: a fifth of a count."""
STEP_s = 0.0005


@pytest.fixture(scope="module")
def robot():
    """Return the committed model, of which only two joints can move, the others are welded at their zero."""
    whole = Robot.from_toml(robot_path("so101"))
    spec = mujoco.MjSpec.from_string(whole.model_xml)
    for joint in whole.joints:
        if joint.name not in MOVING:
            spec.delete(spec.actuator(joint.name))
            spec.delete(spec.joint(joint.name))
    spec.option.timestep = whole.model.opt.timestep
    model = spec.compile()
    joints = []
    for name in MOVING:
        own, actuator = model.joint(name), model.actuator(name)
        places = {"qpos_index": int(own.qposadr[0]), "dof_index": int(own.dofadr[0])}
        joints.append(replace(whole.joint(name), **places, actuator_index=actuator.id))
    return replace(whole, model=model, model_xml=spec.to_xml(), joints=tuple(joints))


def compile_twin(robot):
    """Return the twin in plain MuJoCo: another integrator and shorter steps than those of the diagnosis."""
    spec = mujoco.MjSpec.from_string(robot.model_xml)
    for joint in robot.joints:
        spec.actuator(joint.name).set_to_position(kp=joint.kp_Nm_rad * (1.0 + GAIN_RATIO[joint.name]))
    spec.option.timestep = STEP_s
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICIT
    model = spec.compile()
    model.dof_solref[:, 0] = 2.0 * STEP_s  # friction that holds within two steps
    return model


def smooth_command(seed):
    """Return the commands of both joints, (n, 2) [rad]: three sines each, which begin slowly."""
    random = np.random.default_rng(seed)
    time_s = np.arange(0.0, DURATION_s, ROW_s)
    ramp = np.minimum(time_s, 1.0) ** 2 * (3.0 - 2.0 * np.minimum(time_s, 1.0))
    columns = []
    for name in MOVING:
        share = random.dirichlet(np.ones(3))
        wave = sum(
            part * np.sin(2 * np.pi * (frequency_Hz * time_s + random.uniform()))
            for part, frequency_Hz in zip(share, random.uniform(0.2, 1.2, 3), strict=True)
        )
        columns.append(REST_rad[name] + REACH_rad[name] * ramp * wave)
    return np.stack(columns, axis=1)


def record(robot, seed):
    """Record a motion of the twin, from rest at the first command."""
    sent, model = smooth_command(seed), compile_twin(robot)
    friction_Nm, load_Nm = model.dof_frictionloss.copy(), np.zeros(model.nv)
    data, rows, settle = mujoco.MjData(model), [], round(1.0 / ROW_s)
    data.qpos[:] = sent[0]
    for row, command in enumerate((*(sent[:1].repeat(settle, 0)), *sent)):
        if row >= settle:
            rows.append(data.qpos.copy())
        data.ctrl[:] = command
        for _ in range(round(ROW_s / STEP_s / 2)):
            mujoco.mj_rne(model, data, 1, load_Nm)  # without the armature, which is before the gear
            model.dof_frictionloss[:] = friction_Nm + FRICTION_PER_LOAD * np.abs(load_Nm)
            mujoco.mj_step(model, data, 2)
    shown = np.array(rows) + NOISE_rad * np.random.default_rng(seed).standard_normal(sent.shape)
    shown = COUNT_rad * np.round(shown / COUNT_rad)
    time_s = ROW_s * np.arange(len(shown))
    return motion_of(robot, time_s, shown, sent, f"smooth {seed}")


@pytest.mark.slow
def test_load_dependent_friction_of_the_lift_is_named_beside_gain_errors(robot):
    motions = [record(robot, k) for k in range(10)]
    result = diagnose(robot, motions[:7], held_out=motions[7:], seed=1)
    (finding,) = result.findings
    assert (finding.place, finding.effect) == (LIFT, "load-dependent friction")
    assert finding.size[0] == pytest.approx(0.7, rel=0.25)  # as close as two halves of the real arm must be
    base = {(one.place, one.name): one.value for one in result.base}
    for name, ratio in GAIN_RATIO.items():
        assert base[name, "gain_ratio"] == pytest.approx(ratio, abs=0.02)
    error = {one.joint: one for one in result.errors}
    assert error[LIFT].explained < 0.25 * error[LIFT].base
