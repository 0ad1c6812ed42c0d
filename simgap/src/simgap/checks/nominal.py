"""The nominal model: a simulation of the logged commands by the model as it is."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from simgap.arrays import Array, Flags
from simgap.checks.records import hold, joint_samples
from simgap.logs import JointLog, Motion, Signal
from simgap.mjcf import place_tied
from simgap.robot import Robot
from simgap.simulation.compiled import compile_for, control_laws, nominal_gains
from simgap.simulation.windows import SLOPE_SAMPLES, held_means, local_line


@dataclass(frozen=True, slots=True)
class NominalMotion:
    """The nominal model in one motion."""

    motion: str
    position: Mapping[str, Array]
    """Joint -> predicted position at the times of the logged ones, (n,) [rad]; NaN if it blew up, and before
    all joints have a position."""
    mean_abs_rad: Mapping[str, float]
    """Joint -> mean absolute difference from the logged position."""


class NominalModel:
    """The model of a robot with one motor at each joint, as the robot file describes its controller."""

    def __init__(self, robot: Robot) -> None:
        """Compile the model."""
        self.robot = compile_for(robot, ()).robot
        self.model = self.robot.model
        for joint in self.robot.joints:
            if math.isfinite(joint.torque_limit_Nm):
                limit_Nm = joint.torque_limit_Nm
                self.model.actuator_forcerange[joint.actuator_index] = (-limit_Nm, limit_Nm)

    def simulate(self, motion: Motion) -> NominalMotion:
        """Simulate a motion once, and compare.

        Start and commands are those of a window of a diagnosis, so that both have one error.
        """
        samples = {one.name: joint_samples(motion.joints[one.name]) for one in self.robot.joints}
        begin_s = max((one.time_s[0] for one in samples.values() if one.time_s.size), default=0.0)
        end_s = max((one.time_s[-1] for one in samples.values() if one.time_s.size), default=0.0)
        period_s = self.robot.control_period_s
        tick_s = begin_s + period_s * np.arange(math.ceil((end_s - begin_s) / period_s) + 1)
        path = self._path(motion, tick_s)
        predicted, error = {}, {}
        for k, (name, one) in enumerate(samples.items()):
            at = motion.joints[name].position.time_s
            predicted[name] = np.interp(at, tick_s, path[:, k], left=math.nan)
            difference = np.abs(predicted[name][one.index] - one.position)[one.time_s >= begin_s]
            error[name] = float(np.mean(difference)) if difference.size else math.nan
        return NominalMotion(motion.name, predicted, error)

    def _path(self, motion: Motion, tick_s: Array) -> Array:
        """Step through the control periods; return the positions at them, (n, n_joints) [rad].

        They are NaN if a loop has no gain, or if the simulation blew up.
        """
        joints, model, data = self.robot.joints, self.model, mujoco.MjData(self.model)
        if not all(one.knows_gains for one in joints):
            return np.full((tick_s.size, len(joints)), np.nan)
        edges_s = np.append(tick_s, tick_s[-1] + self.robot.control_period_s) - 0.5 * model.opt.timestep
        command = np.stack([_commands(motion.joints[one.name], edges_s) for one in joints], axis=1)
        is_on = np.stack([_enabled(motion.joints[one.name], edges_s[:-1]) for one in joints], axis=1)
        for one in joints:
            data.qpos[one.qpos_index], data.qvel[one.dof_index] = _start(motion.joints[one.name], tick_s[0])
        place_tied(model, [one.dof_index for one in joints], data.qpos, data.qvel)
        qpos = [one.qpos_index for one in joints]
        actuators = [one.actuator_index for one in joints]
        path = np.full((tick_s.size, len(joints)), np.nan)
        n_steps = round(self.robot.control_period_s / model.opt.timestep)
        last: Flags = np.zeros(0, np.bool_)
        for tick in range(tick_s.size):
            path[tick] = data.qpos[qpos]
            if not np.array_equal(is_on[tick], last):
                last = is_on[tick]
                self._set_gains(motion, last)
            data.ctrl[actuators] = command[tick]
            mujoco.mj_step(model, data, n_steps)
            if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
                path[:] = np.nan
                break
        return path

    def _set_gains(self, motion: Motion, is_on: Flags) -> None:
        """Write the gains of the controllers; a motor that is off has none."""
        joints = self.robot.joints
        kp, kd = nominal_gains(self.robot)
        gains = np.array([motion.gain.get(one.name, 1.0) for one in joints])
        gain, bias = control_laws(self.robot, (kp * gains)[None], kd[None])
        actuators = [one.actuator_index for one in joints]
        self.model.actuator_gainprm[actuators, 0] = gain[0] * is_on
        self.model.actuator_biasprm[actuators, :3] = bias[0] * is_on[:, None]


def _commands(log: JointLog, edges_s: Array) -> Array:
    """Return the mean of the command between edges, (n,); its last number holds where there is none."""
    if log.command is None:
        return np.zeros(edges_s.size - 1)
    is_number = np.isfinite(log.command.value)
    if not np.any(is_number):
        return np.zeros(edges_s.size - 1)
    return held_means(Signal(log.command.time_s[is_number], log.command.value[is_number]), edges_s)


def _enabled(log: JointLog, tick_s: Array) -> Flags:
    """Return the ticks at which the motor is on, (n,); without a command it is off."""
    if log.enabled is None or log.command is None:
        return np.full(tick_s.size, log.command is not None)
    return np.asarray(hold(log.enabled, tick_s) > 0.5)


def _start(log: JointLog, time_s: float) -> tuple[float, float]:
    """Return position and velocity at the start [rad, rad/s]."""
    one = joint_samples(log)
    if one.time_s.size < SLOPE_SAMPLES:
        return (float(one.position[0]) if one.time_s.size else 0.0), 0.0
    return local_line(Signal(one.time_s, one.position), time_s)
