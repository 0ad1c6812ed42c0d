"""An arm with two joints in a vertical plane, and logs of it from forward simulation with known effects."""

import math
from dataclasses import replace

import mujoco
import numpy as np

from simgap.logs import JointLog, Motion, Signal
from simgap.robot import ControlMode, Robot, RobotJoint

XML = """
<mujoco model="two joints">
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="upper arm" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" armature="0.5" damping="2" frictionloss="3"/>
      <inertial pos="0.2 0 0" mass="4" diaginertia="0.05 0.05 0.05"/>
      <body name="forearm" pos="0.4 0 0">
        <joint name="elbow" axis="0 1 0" armature="0.2" damping="1" frictionloss="1"/>
        <inertial pos="0.15 0 0.02" mass="2" diaginertia="0.02 0.02 0.02"/>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
PERIOD_s = 0.004
SETTLING_s = 0.5
"""Rest before the path, in which the arm sags."""
STIFFNESS = (400.0, 200.0)
DAMPING = (20.0, 8.0)


def arm(*, is_loaded=True):
    """Return the robot; without load, both joints are told to carry no gravity."""
    mode, limit_Nm = ControlMode.TORQUE, math.inf
    model = mujoco.MjModel.from_xml_string(XML)
    joints = tuple(
        RobotJoint(name, k, k, mode, 0.0, 0.0, limit_Nm, gear_ratio=50.0, is_loaded_by_gravity=is_loaded)
        for k, name in enumerate(("shoulder", "elbow"))
    )
    return Robot("two joints", model, XML, joints, PERIOD_s, "")


def wanted_rad(time_s, seed):
    """Return a smooth path of both joints that begins at rest."""
    rng = np.random.default_rng(seed)
    time_s = max(time_s - SETTLING_s, 0.0)
    speeds, sizes = rng.uniform(0.6, 2.5, (2, 3)), rng.uniform(0.1, 0.35, (2, 3))
    return np.asarray(np.sum(sizes * (1 - np.cos(speeds * time_s)), axis=1) * (1.0, -1.0))


def simulated(
    robot, seed, duration_s=4.0, change=lambda model: None, applied_Nm=np.zeros_like, noise_rad=0.0, name="m"
):
    """Simulate the arm under a position loop, and log positions and motor torques.

    Args:
        robot: Robot.
        seed: Seed of path and noise.
        duration_s: Length [s].
        change: Difference of the true arm from the model.
        applied_Nm: Torques beside those of the motors at positions, (2,) each.
        noise_rad: Standard deviation of the noise of positions.
        name: Name of the motion.
    """
    model = mujoco.MjModel.from_xml_string(XML)
    model.dof_solimp[:] = (0.9999, 0.9999, 0.001, 0.5, 2.0)  # dry friction that does not creep
    model.dof_solref[:] = (2 * model.opt.timestep, 1.0)
    change(model)
    data = mujoco.MjData(model)
    data.qpos[:] = wanted_rad(0.0, seed)
    steps = round(PERIOD_s / model.opt.timestep)
    n = round(duration_s / PERIOD_s) + 1
    q, torque = np.empty((n, 2)), np.empty((n, 2))
    before = round(0.4 / model.opt.timestep)
    for k in range(-before, n * steps):
        motor = STIFFNESS * (wanted_rad(data.time, seed) - data.qpos) - np.multiply(DAMPING, data.qvel)
        if k >= 0 and k % steps == 0:
            q[k // steps], torque[k // steps] = data.qpos, motor
        data.qfrc_applied[:] = motor + applied_Nm(data.qpos)
        mujoco.mj_step(model, data)
    q += noise_rad * np.random.default_rng(seed).standard_normal(q.shape)
    time_s = PERIOD_s * np.arange(n)
    signals = [(Signal(time_s, q[:, j]), Signal(time_s, torque[:, j])) for j in range(2)]
    logs = [JointLog(position, torque=own) for position, own in signals]
    return Motion(name, {joint.name: log for joint, log in zip(robot.joints, logs, strict=True)}, {})


def rms(values):
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def check_promises(make, log, effects, sizes):
    """Check that 0 changes no bit, that candidates do not depend on one another, and that parts stay."""
    model = make([log])
    plain = model.residuals([], np.zeros((1, 0)))[0]
    assert np.array_equal(model.residuals(effects, np.zeros((2, sizes.shape[1])))[1], plain)
    for row, one in zip(model.residuals(effects, sizes), sizes, strict=True):
        assert np.array_equal(model.residuals(effects, one[None])[0], row)
    whole = make([replace(log, name=name) for name in ("a", "b", "c")])
    part = whole.select(["c", "a"])
    assert part.motions == ("a", "c")
    kept = whole.residuals(effects, sizes)[:, whole.motion_of != 1]
    assert np.array_equal(part.residuals(effects, sizes), kept)
