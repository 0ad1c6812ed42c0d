"""Rotors: motors that turn a degree of freedom of their own, behind a gear with backlash or compliance."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco.batch
import numpy as np

from simgap.arrays import Array, Integers
from simgap.effects.effect import Fields, Rotor
from simgap.robot import ControlMode, Robot


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
        """Find the places, and let the actuators turn the rotors.

        Args:
            robot: Robot with the compiled model.
            fields: Fields after all effects.
        """
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
        """Move numbers of joints to their rotors.

        Args:
            field: Field of the model, (n_sims, n_dofs), in the unit of the values; it is written.
            value: Values of the joints, (n, n_joints), in any unit, of the first n simulations.
        """
        for one in self._places:
            rows = one.rows[one.rows < value.shape[0]]
            field[rows, one.dof] = value[rows, one.joint]
            field[rows, one.joint_dof] = 0.0

    def clear(self, value: Array) -> None:
        """Set numbers of joints to 0 where a rotor has them, (n_sims, n_joints)."""
        for one in self._places:
            value[one.rows, one.joint] = 0.0

    def start(self, batch: mujoco.batch.Batch) -> None:
        """Put the rotors at the positions and speeds of their joints."""
        qpos, qvel = batch.bind("qpos"), batch.bind("qvel")
        for one in self._places:
            qpos[one.rows, one.qpos] = qpos[one.rows, one.joint_qpos]
            qvel[one.rows, one.dof] = qvel[one.rows, one.joint_dof]

    def show(self, qpos: Array, shown_rad: Array) -> None:
        """Write the angles of rotors that have the encoder over those of their joints.

        Args:
            qpos: Positions of the model, (..., n_sims, n_qpos) [rad].
            shown_rad: Positions of the joints, (..., n_sims, n_joints); it is written.
        """
        for one in self._places:
            if not one.encoder_is_at_output:
                shown_rad[..., one.rows, one.joint] = qpos[..., one.rows, one.qpos]

    def close_loops(self, qpos: Array, qvel: Array, command: Array) -> None:
        """Shift commands so that the loop closes at the encoder at the output, not at the rotor.

        Args:
            qpos: Positions of the model, (n_sims, n_qpos) [rad].
            qvel: Speeds of the model, (n_sims, n_dofs) [rad/s].
            command: Commands of the first n simulations, (n, n_joints) [rad or rad/s]; it is written.
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
