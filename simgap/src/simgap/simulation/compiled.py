"""Models for the engine: one affine actuator at each joint, dry friction that does not creep."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import mujoco
import mujoco.batch
import numpy as np

from simgap.arrays import Array, Integers
from simgap.effects.effect import Effect, Fields
from simgap.robot import ControlMode, Robot

HARD_IMPEDANCE: Final = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""Impedance of dry friction at its upper bound: with the default, a joint creeps under load."""
UNLIMITED_Nm: Final = 1e9
"""Stands for an infinite torque limit, which MuJoCo does not take."""


Places = slice | Integers
"""Places of the joints in an array of the model; a slice where they follow one another, which is faster."""


@dataclass(frozen=True, slots=True)
class Compiled:
    """A model with the bodies that effects have added, and the places of the joints in it."""

    robot: Robot
    """The robot with this model and its indices."""
    qpos: Places
    dof: Places
    actuator: Places


class Models:
    """Compiled models of a robot, each kept for the effects that vary it."""

    def __init__(self, robot: Robot) -> None:
        """Keep the robot."""
        self.robot = robot
        self._kept: dict[tuple[str, ...], Compiled] = {}

    def compiled(self, effects: Sequence[Effect]) -> Compiled:
        """Return the model with what effects add to it.

        Args:
            effects: Effects, of which those with `vary` change the model.

        Returns:
            The model, compiled at the first call.
        """
        key = tuple(effect.key for effect in effects if effect.overrides("vary"))
        if key not in self._kept:
            self._kept[key] = compile_for(self.robot, effects)
        return self._kept[key]


def compile_for(robot: Robot, effects: Sequence[Effect]) -> Compiled:
    """Compile the model of a robot with what effects add to it.

    The actuators of the joints are replaced by affine ones: an implicit integrator sees their damping.

    Args:
        robot: Robot; its time step is kept.
        effects: Effects, of which those with `vary` change the model.

    Returns:
        The model.
    """
    spec = mujoco.MjSpec.from_string(robot.model_xml)
    spec.option.timestep = robot.model.opt.timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    joints = {robot.model.joint(int(robot.model.dof_jntid[j.dof_index])).name: j for j in robot.joints}
    for part in (*spec.keys, *spec.sensors, *(a for a in spec.actuators if a.target in joints)):
        spec.delete(part)
    for name in joints:
        joint = spec.joint(name)
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE  # the torque limit of the motor holds it
        joint.solimp_friction = HARD_IMPEDANCE
        # twice the step is the shortest time constant that MuJoCo keeps
        joint.solref_friction = (2 * robot.model.opt.timestep, 1.0)
        motor = spec.add_actuator(name=_actuator(name), target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.gaintype, motor.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        motor.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
        motor.forcerange = (-UNLIMITED_Nm, UNLIMITED_Nm)
    for effect in effects:
        if effect.overrides("vary"):
            effect.vary(spec, robot)
    model = spec.compile()
    _skip_idle_stages(model)
    found = []
    for name, joint in joints.items():
        index = model.joint(name)
        found.append(
            replace(
                joint,
                qpos_index=int(index.qposadr[0]),
                dof_index=int(index.dofadr[0]),
                actuator_index=model.actuator(_actuator(name)).id,
            )
        )
    return Compiled(
        robot=replace(robot, model=model, joints=tuple(found)),
        qpos=_places([joint.qpos_index for joint in found]),
        dof=_places([joint.dof_index for joint in found]),
        actuator=_places([joint.actuator_index for joint in found]),
    )


def _skip_idle_stages(model: mujoco.MjModel) -> None:
    """Switch off stages of a step that can change no bit of this model, but take a fifth of its time."""
    can_touch = model.geom_contype.any() and model.geom_conaffinity.any()
    if not (can_touch or model.npair or model.nflex):
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    if model.ntree == 1:  # all its constraints are one island
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND


def _places(indices: list[int]) -> Places:
    first = indices[0]
    if indices == list(range(first, first + len(indices))):
        return slice(first, first + len(indices))
    return np.array(indices)


def _actuator(joint: str) -> str:
    return f"motor of {joint}"


def control_laws(robot: Robot, kp: Array, kd: Array) -> tuple[Array, Array]:
    """Compute the coefficients of the affine actuators.

    Args:
        robot: Robot with the control modes.
        kp: Stiffness, or torque per unit of the command, (n_sims, n_joints) [N m/rad].
        kd: Damping, (n_sims, n_joints) [N m s/rad].

    Returns:
        Gain on the command, (n_sims, n_joints), and bias on (1, position, velocity), (n_sims, n_joints, 3).
    """
    gain = np.empty_like(kp)
    bias = np.zeros((*kp.shape, 3))
    for j, joint in enumerate(robot.joints):
        match joint.mode:
            case ControlMode.POSITION:
                gain[:, j] = kp[:, j]
                bias[:, j, 1], bias[:, j, 2] = -kp[:, j], -kd[:, j]
            case ControlMode.VELOCITY:
                gain[:, j] = kd[:, j]
                bias[:, j, 2] = -kd[:, j]
            case ControlMode.TORQUE | ControlMode.CURRENT:
                gain[:, j] = kp[:, j]
    return gain, bias


def nominal_fields(robot: Robot, n_sims: int, batch: mujoco.batch.Batch) -> Fields:
    """Return the numbers of model and controllers without effects.

    Args:
        n_sims: Number of simulations.
        batch: Models of the simulations, in which effects change other fields.

    Returns:
        The numbers, a row a simulation.
    """
    model, (kp, kd) = robot.model, nominal_gains(robot)
    dof = [joint.dof_index for joint in robot.joints]

    def rows(values: Array) -> Array:
        return np.tile(values, (n_sims, 1))

    return Fields(
        kp_Nm_rad=rows(kp),
        kd_Nms_rad=rows(kd),
        torque_limit_Nm=rows(np.array([joint.torque_limit_Nm for joint in robot.joints])),
        damping_Nms_rad=rows(model.dof_damping[dof].reshape(-1)),
        frictionloss_Nm=rows(model.dof_frictionloss[dof]),
        armature_kgm2=rows(model.dof_armature[dof]),
        batch=batch,
    )


def step_armature(robot: Robot, fields: Fields) -> Array:
    """Compute the armature with which steps of the integrator are of second order.

    The implicit step takes the damping at its end, which acts like more inertia: half a step times the
    damping. Without it the step is a trapezoidal rule, and SO-101 errs by a fifth as much at 5 ms.

    Args:
        robot: Robot with its time step and control modes.
        fields: Numbers after all effects, with a damping of at least 0.

    Returns:
        Armature, at least 0, (n_sims, n_joints) [kg m2].
    """
    is_closed = [joint.mode in (ControlMode.POSITION, ControlMode.VELOCITY) for joint in robot.joints]
    damping = fields.damping_Nms_rad + np.where(is_closed, fields.kd_Nms_rad, 0.0)
    excess = 0.5 * float(robot.model.opt.timestep) * damping
    return np.asarray(np.maximum(fields.armature_kgm2 - excess, 0.0))


def nominal_gains(robot: Robot) -> tuple[Array, Array]:
    """Return kp, or torque per unit of the command, and kd of the joints, (n_joints,) each."""
    kp = np.array(
        [
            {ControlMode.TORQUE: 1.0, ControlMode.CURRENT: joint.torque_constant_Nm_A}.get(
                joint.mode, joint.kp_Nm_rad
            )
            for joint in robot.joints
        ]
    )
    return kp, np.array([joint.kd_Nms_rad for joint in robot.joints])
