"""Gravity load, deflection and wind-up: where the compliant arm comes to rest."""

from dataclasses import dataclass

import numpy as np

from fsw.kinematics.arm import Arm
from fsw.kinematics.chain import Frames, forward
from fsw.kinematics.transforms import Array, rotation_x, rotation_y

EQUILIBRIUM_TOLERANCE = 1e-11
MAX_PASSES = 30


@dataclass(frozen=True, slots=True, eq=False)
class Equilibrium:
    """The arm at rest under gravity."""

    output_rad: Array
    """Joint angles at the output, (..., 5)."""
    strain: Array
    """Spring displacements, (..., 6, 6), rotation first."""
    torque_Nm: Array
    """Torque of the load on each joint's output, (..., 5)."""
    frames: Frames
    converged: Array
    """(...) bool."""


def load(arm: Arm, frames: Frames, strain: Array, gravity_R_m_s2: Array) -> tuple[Array, Array]:
    """The strain that the springs take under the load of these frames, and the joint torques.

    Paper equations 4 and 5, with the load at the deflected pose. Gravity (..., 3) in the rover frame;
    strain (..., 6, 6) and torque (..., 5) out.
    """
    g = gravity_R_m_s2[..., None, :]
    near = (frames.X_RC[..., :3, :3] @ arm.near_p_C_m[..., None])[..., 0] + frames.X_RC[..., :3, 3]
    far = (frames.X_RD[..., :3, :3] @ arm.far_p_C_m[..., None])[..., 0] + frames.X_RD[..., :3, 3]
    near_kg_m = arm.near_kg[:, None] * near
    carried_kg_m = np.cumsum((near_kg_m + arm.far_kg[:, None] * far)[..., ::-1, :], axis=-2)[..., ::-1, :]
    carried_kg = np.cumsum((arm.near_kg + arm.far_kg)[::-1])[::-1]

    spring_kg = (carried_kg - arm.near_kg)[:, None]
    moment = np.cross(carried_kg_m - near_kg_m - spring_kg * frames.X_RD[..., :3, 3], g)
    new_strain = _yield(arm, frames, strain, moment, spring_kg * g)

    lever_kg_m = carried_kg_m[..., 1:, :] - carried_kg[1:, None] * frames.X_RF[..., :5, :3, 3]
    torque = np.sum(np.cross(lever_kg_m, g) * frames.X_RF[..., :5, :3, 2], axis=-1)
    return new_strain, torque


def _yield(arm: Arm, frames: Frames, strain: Array, moment_R: Array, force_R: Array) -> Array:
    """Compliance times the load as the spring's own coordinates feel it: its later axes have turned."""
    R_CR = np.swapaxes(frames.X_RC[..., :3, :3], -1, -2)
    moment = (R_CR @ moment_R[..., None])[..., 0]
    force = (R_CR @ np.broadcast_to(force_R, moment_R.shape)[..., None])[..., 0]
    R_x = rotation_x(strain[..., 0])
    R_xy = R_x @ rotation_y(strain[..., 1])
    wrench = np.empty((*moment.shape[:-1], 6))
    wrench[..., 0] = moment[..., 0]
    wrench[..., 1] = np.sum(R_x[..., 1] * moment, axis=-1)
    wrench[..., 2] = np.sum(R_xy[..., 2] * moment, axis=-1)
    wrench[..., 3:] = force
    new_strain: Array = (arm.compliance @ wrench[..., None])[..., 0]
    return new_strain


def settle(arm: Arm, motor_rad: Array, gap_rad: Array, gravity_R_m_s2: Array) -> Equilibrium:
    """The rest pose for motor angles and gaps (..., 5): output = motor + gap + torque / stiffness."""
    return _equilibrium(arm, motor_rad + gap_rad, 1.0 / arm.gear_stiffness_Nm_rad, gravity_R_m_s2)


def rest(arm: Arm, output_rad: Array, gravity_R_m_s2: Array) -> Equilibrium:
    """The rest pose for output angles (..., 5), whatever the gears do to hold them."""
    return _equilibrium(arm, output_rad, np.zeros_like(arm.gear_stiffness_Nm_rad), gravity_R_m_s2)


def _equilibrium(arm: Arm, anchor_rad: Array, gear_rad_Nm: Array, gravity_R_m_s2: Array) -> Equilibrium:
    """Fixed point of load and strain; each pass takes off a factor of twenty or more."""
    strain = np.zeros((*anchor_rad.shape[:-1], 6, 6))
    output = anchor_rad
    for _ in range(MAX_PASSES):
        frames = forward(arm, output, strain)
        new_strain, torque = load(arm, frames, strain, gravity_R_m_s2)
        new_output = anchor_rad + torque * gear_rad_Nm
        step = np.maximum(
            np.max(np.abs(new_strain - strain), axis=(-2, -1)), np.max(np.abs(new_output - output), axis=-1)
        )
        strain, output = new_strain, new_output
        if np.all(step < EQUILIBRIUM_TOLERANCE):
            break
    return Equilibrium(output, strain, torque, forward(arm, output, strain), step < EQUILIBRIUM_TOLERANCE)
