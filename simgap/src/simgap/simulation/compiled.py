"""Models for the engine: affine actuators, dry friction that does not creep, rotors behind their gears."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import mujoco
import mujoco.batch
import numpy as np

from simgap.arrays import Array, Integers
from simgap.effects.effect import Effect, Fields, Rotor
from simgap.mjcf import take_out_joints
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
        """Return the model with what effects add to it, compiled at the first call."""
        key = tuple(effect.key for effect in effects if effect.overrides("vary"))
        if key not in self._kept:
            self._kept[key] = compile_for(self.robot, effects)
        return self._kept[key]


def compile_for(robot: Robot, effects: Sequence[Effect]) -> Compiled:
    """Compile the model of a robot with what effects add to it.

    The actuators of the joints are replaced by affine ones: an implicit integrator sees their damping.
    """
    spec = mujoco.MjSpec.from_string(robot.model_xml)
    take_out_joints(spec, robot.left_out)
    spec.option.timestep = robot.model.opt.timestep
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.compiler.discardvisual = True  # a mesh that is only seen would be kept with each model
    joints = {robot.model.joint(int(robot.model.dof_jntid[j.dof_index])).name: j for j in robot.joints}
    old = [a for a in spec.actuators if a.target in joints]
    rotors = {name: _rotor_numbers([a for a in old if a.target == name]) for name in joints}
    for part in (*spec.keys, *spec.sensors, *old):
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
        motor.armature, motor.damping = rotors[name]
    for effect in effects:
        if effect.overrides("vary"):
            effect.vary(spec, robot)
    model = spec.compile()
    _skip_idle_stages(model)
    _choose_solver(model)
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


def _rotor_numbers(actuators: Sequence[mujoco.MjsActuator]) -> tuple[float, Array]:
    """Return armature and damping of the actuators of a joint, seen at the joint."""
    gears = [abs(float(one.gear[0])) for one in actuators]
    armature = sum(gear**2 * one.armature for gear, one in zip(gears, actuators, strict=True))
    # the coefficients of the speed, its square and its cube
    damping = [gear ** np.array((2, 3, 4)) * one.damping for gear, one in zip(gears, actuators, strict=True)]
    return float(armature), np.sum([np.zeros(3), *damping], axis=0)


def _skip_idle_stages(model: mujoco.MjModel) -> None:
    """Switch off stages of a step that can change no bit of this model, but take a fifth of its time."""
    can_touch = model.geom_contype.any() and model.geom_conaffinity.any()
    if not (can_touch or model.npair or model.nflex):
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    if model.ntree == 1:  # all its constraints are one island
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND


def _choose_solver(model: mujoco.MjModel) -> None:
    """Solve dry friction and limits of joints by the method of Gauss and Seidel where there is nothing else.

    A step takes 0.94 of that of Newton's method with one joint, and 0.87 with six.
    """
    only_joints = not (model.neq or model.ntendon)
    if only_joints and model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_CONTACT:
        model.opt.solver = mujoco.mjtSolver.mjSOL_PGS


def _places(indices: list[int]) -> Places:
    first = indices[0]
    if indices == list(range(first, first + len(indices))):
        return slice(first, first + len(indices))
    return np.array(indices)


def _actuator(joint: str) -> str:
    return f"motor of {joint}"


def control_laws(robot: Robot, kp: Array, kd: Array) -> tuple[Array, Array]:
    """Compute gain on commands, (n_sims, n_joints), and bias on (1, position, speed), (n_sims, n_joints, 3).

    These are the coefficients of affine actuators. `kp` [N m/rad] is stiffness, or torque per unit of the
    command, and `kd` [N m s/rad] damping, (n_sims, n_joints) each.
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
            case ControlMode.VOLTAGE:
                gain[:, j] = kp[:, j]
                bias[:, j, 2] = -kd[:, j]
    return gain, bias


def nominal_fields(robot: Robot, n_sims: int, batch: mujoco.batch.Batch) -> Fields:
    """Return the numbers of model and controllers without effects."""
    model, (kp, kd) = robot.model, nominal_gains(robot)
    dof = [joint.dof_index for joint in robot.joints]

    def rows(values: Array) -> Array:
        return np.tile(values, (n_sims, 1))

    return Fields(
        kp_Nm_rad=rows(kp),
        kd_Nms_rad=rows(kd),
        back_emf_Nms_rad=np.zeros((n_sims, len(dof))),
        torque_limit_Nm=rows(np.array([joint.torque_limit_Nm for joint in robot.joints])),
        damping_Nms_rad=rows(model.dof_damping[dof].reshape(-1)),
        frictionloss_Nm=rows(model.dof_frictionloss[dof]),
        armature_kgm2=rows(model.dof_armature[dof]),
        batch=batch,
        torque_scale=np.ones((n_sims, len(dof))),
    )


def powered_numbers(robot: Robot, fields: Fields, enabled: Array) -> tuple[Array, Array]:
    """Compute damping and armature of joints whose motors have power where `enabled` is 1, (n, n_joints).

    The implicit step takes the damping at its end, which acts like more inertia: half a step times the
    damping. With so much less armature it is a trapezoidal rule, and SO-101 errs by a fifth as much at 5 ms.
    """
    n = enabled.shape[0]
    damping = fields.damping_Nms_rad[:n] + fields.back_emf_Nms_rad[:n] * enabled
    is_damped = [joint.mode not in (ControlMode.TORQUE, ControlMode.CURRENT) for joint in robot.joints]
    kd = np.where(is_damped, fields.kd_Nms_rad[:n] * enabled, 0.0)
    # gains are not known where torques are compared
    excess = 0.5 * float(robot.model.opt.timestep) * (damping + np.nan_to_num(kd))
    return damping, np.maximum(fields.armature_kgm2[:n] - excess, 0.0)


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


@dataclass(frozen=True, slots=True)
class _Place:
    """Places of a rotor and of its joint in the arrays of the model."""

    rows: Integers
    """Simulations in which the motor turns the rotor."""
    joint: int
    encoder_is_at_output: bool
    mode: ControlMode
    qpos: int
    dof: int
    joint_qpos: int
    joint_dof: int


class Rotors:
    """All rotors of a batch. Without any, nothing is written."""

    def __init__(self, robot: Robot, fields: Fields) -> None:
        """Find the places, and let the actuators turn the rotors."""
        rotors = _one_for_each_joint(fields.rotors)
        self._places: Sequence[_Place] = [
            _place(robot, one.joint, one.name, np.flatnonzero(one.rows), one.encoder_is_at_output)
            for one in rotors
        ]
        self.close_at_output = any(one.rows.size and one.encoder_is_at_output for one in self._places)
        """True if commands must be shifted in each control period."""
        for one, rotor in zip(self._places, rotors, strict=True):
            target = fields.batch.expand("actuator_trnid")
            target[one.rows, robot.joints[one.joint].actuator_index, 0] = robot.model.joint(rotor.name).id

    def move(self, field: Array, value: Array) -> None:
        """Move values of the first simulations, (n, n_joints), to rotors in a field, (n_sims, n_dofs)."""
        for one in self._places:
            rows = one.rows[one.rows < value.shape[0]]
            field[rows, one.dof] = value[rows, one.joint]
            field[rows, one.joint_dof] = 0.0

    def start(self, batch: mujoco.batch.Batch) -> None:
        """Put the rotors at the positions and speeds of their joints."""
        qpos, qvel = batch.bind("qpos"), batch.bind("qvel")
        for one in self._places:
            qpos[one.rows, one.qpos] = qpos[one.rows, one.joint_qpos]
            qvel[one.rows, one.dof] = qvel[one.rows, one.joint_dof]

    def show(self, qpos: Array, shown_rad: Array) -> None:
        """Write the angles of rotors that have the encoder over those of their joints.

        `qpos` [rad] is (..., n_sims, n_qpos); `shown_rad`, (..., n_sims, n_joints), is written.
        """
        for one in self._places:
            if not one.encoder_is_at_output:
                shown_rad[..., one.rows, one.joint] = qpos[..., one.rows, one.qpos]

    def close_loops(self, qpos: Array, qvel: Array, command: Array) -> None:
        """Shift commands so that the loop closes at the encoder at the output, not at the rotor.

        `qpos` [rad] is (n_sims, n_qpos), and `qvel` [rad/s] (n_sims, n_dofs). Commands of the first n
        simulations, (n, n_joints) [rad or rad/s], are written.
        """
        for one in self._places:
            if not one.encoder_is_at_output:
                continue
            rows = one.rows[one.rows < command.shape[0]]
            if one.mode is ControlMode.POSITION:
                command[rows, one.joint] += qpos[rows, one.qpos] - qpos[rows, one.joint_qpos]
            elif one.mode is ControlMode.VELOCITY:
                command[rows, one.joint] += qvel[rows, one.dof] - qvel[rows, one.joint_dof]


def _one_for_each_joint(rotors: Sequence[Rotor]) -> list[Rotor]:
    """Join the rotors of a joint with backlash and compliance: its loop must close once."""
    joined: dict[int, Rotor] = {}
    for one in rotors:
        rows = one.rows | joined[one.joint].rows if one.joint in joined else one.rows
        joined[one.joint] = replace(one, rows=rows)
    return list(joined.values())


def _place(robot: Robot, index: int, name: str, rows: Integers, encoder_is_at_output: bool) -> _Place:
    joint, rotor = robot.joints[index], robot.model.joint(name)
    return _Place(
        rows=rows,
        joint=index,
        encoder_is_at_output=encoder_is_at_output,
        mode=joint.mode,
        qpos=int(rotor.qposadr[0]),
        dof=int(rotor.dofadr[0]),
        joint_qpos=joint.qpos_index,
        joint_dof=joint.dof_index,
    )
