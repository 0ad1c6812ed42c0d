"""A synthetic twin of the SO-101: its model with errors that are known, logged as the real arm was.

The twin steps plain MuJoCo, with another integrator and a shorter time step than the diagnosis.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from helpers.real_robots import robot_path
from simgap.logs import JointLog, Motion, Signal
from simgap.robot import Robot

ROW_s = 0.02
COUNT_rad = 2 * np.pi / 4096
NOISE_rad = 0.3e-3
"""Standard deviation of a position before it is rounded to counts: a fifth of a count."""
STEP_s = 0.0005
REST = {"elbow_flex": 0.5, "gripper": 0.785}
"""Command from which all motions start [rad]; 0 at the other joints. The gripper is half open."""


@dataclass(frozen=True, slots=True)
class Truth:
    """Errors of the twin."""

    gain_ratio: Mapping[str, float] = field(default_factory=dict)
    """Relative change of the stiffness of a joint's servo."""
    coulomb_Nm: Mapping[str, float] = field(default_factory=dict)
    """Dry friction beside that of the model."""
    friction_per_load: Mapping[str, float] = field(default_factory=dict)
    """Dry friction per torque that the gear carries: of gravity, and of the inertia behind it."""


def so101():
    """Return the committed model."""
    return Robot.from_toml(robot_path("so101"))


def with_locked_joints(robot, free):
    """Return a robot of which only these joints can move, the others are welded at their zero."""
    spec = mujoco.MjSpec.from_string(robot.model_xml)
    for joint in robot.joints:
        if joint.name not in free:
            spec.delete(spec.actuator(joint.name))
            spec.delete(spec.joint(joint.name))
    spec.option.timestep = robot.model.opt.timestep
    model = spec.compile()
    joints = []
    for joint in (one for one in robot.joints if one.name in free):
        own, actuator = model.joint(joint.name), model.actuator(joint.name)
        places = {"qpos_index": int(own.qposadr[0]), "dof_index": int(own.dofadr[0])}
        joints.append(replace(joint, **places, actuator_index=actuator.id))
    return replace(robot, model=model, model_xml=spec.to_xml(), joints=tuple(joints))


def record(robot, truth, name, command, seed):
    """Record a motion of the twin.

    Args:
        robot: Nominal robot.
        truth: Errors of the twin.
        name: Name of the motion.
        command: Joint -> command of each row of the log, (n,) [rad].
        seed: Seed of the noise of the encoders.
    """
    sent = np.stack([command[joint.name] for joint in robot.joints], axis=1)
    rows = _positions(robot, truth, sent)
    rows += NOISE_rad * np.random.default_rng(seed).standard_normal(rows.shape)
    rows = COUNT_rad * np.round(rows / COUNT_rad)
    time_s = ROW_s * np.arange(len(rows))
    joints = {
        joint.name: JointLog(position=Signal(time_s, rows[:, j]), command=Signal(time_s, sent[:, j]))
        for j, joint in enumerate(robot.joints)
    }
    return Motion(name, joints, {})


def _positions(robot, truth, sent):
    """Return the true positions at each row, (n, n_joints) [rad], from rest at the first command."""
    names, model = [joint.name for joint in robot.joints], _model(robot, truth)
    dof = [int(model.joint(name).dofadr[0]) for name in names]
    share = np.array([truth.friction_per_load.get(name, 0.0) for name in names])
    friction_Nm, load_Nm = model.dof_frictionloss[dof], np.zeros(model.nv)
    data, rows, settle = mujoco.MjData(model), [], round(1.0 / ROW_s)
    data.qpos[dof] = sent[0]
    for row, command in enumerate((*(sent[:1].repeat(settle, 0)), *sent)):
        if row >= settle:
            rows.append(data.qpos[dof])
        data.ctrl[:] = command
        for _ in range(round(ROW_s / STEP_s / 2)):
            if share.any():
                mujoco.mj_rne(model, data, 1, load_Nm)  # without the armature, which is before the gear
                model.dof_frictionloss[dof] = friction_Nm + share * np.abs(load_Nm[dof])
            mujoco.mj_step(model, data, 2)
    return np.array(rows)


def _model(robot, truth):
    """Compile the twin: its servos and its friction."""
    spec = mujoco.MjSpec.from_string(robot.model_xml)
    for joint in robot.joints:
        kp_Nm_rad = joint.kp_Nm_rad * (1.0 + truth.gain_ratio.get(joint.name, 0.0))
        spec.actuator(joint.name).set_to_position(kp=kp_Nm_rad)
    for name, more_Nm in truth.coulomb_Nm.items():
        spec.joint(name).frictionloss += more_Nm
    spec.option.timestep = STEP_s
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICIT
    model = spec.compile()
    model.dof_solref[:, 0] = 2.0 * STEP_s  # friction that holds within two steps
    return model


def smooth_command(robot, seed, duration_s, reach_rad):
    """Return smooth commands: three sines at each joint that moves, which begin slowly.

    Args:
        robot: Robot.
        seed: Seed of phases, periods and shares.
        duration_s: Length.
        reach_rad: Joint -> largest distance from its rest; joints that are not here stay there.
    """
    random = np.random.default_rng(seed)
    time_s = np.arange(0.0, duration_s, ROW_s)
    ramp = np.minimum(time_s, 1.0) ** 2 * (3.0 - 2.0 * np.minimum(time_s, 1.0))
    found = {}
    for joint in robot.joints:
        share = random.dirichlet(np.ones(3))
        wave = sum(
            part * np.sin(2 * np.pi * (frequency_Hz * time_s + random.uniform()))
            for part, frequency_Hz in zip(share, random.uniform(0.2, 1.2, 3), strict=True)
        )
        found[joint.name] = REST.get(joint.name, 0.0) + reach_rad.get(joint.name, 0.0) * ramp * wave
    return found
