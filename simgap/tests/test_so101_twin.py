"""What was put into a synthetic twin of the SO-101 is found: gains, and friction by the load.

The twin steps plain MuJoCo, with another integrator and a shorter time step than the diagnosis, and is logged
as the real arm was.
"""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from helpers.real_robots import robot_path
from simgap.diagnosis import diagnose
from simgap.logs import JointLog, Motion, Signal
from simgap.robot import Robot

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
    joints = {
        name: JointLog(position=Signal(time_s, shown[:, j]), command=Signal(time_s, sent[:, j]))
        for j, name in enumerate(MOVING)
    }
    return Motion(f"smooth {seed}", joints, {})


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
