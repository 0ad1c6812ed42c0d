"""Gravity load, deflection and wind-up: where the compliant arm comes to rest."""

from dataclasses import dataclass

import numpy as np

from fsw.kinematics.arm import Arm
from fsw.kinematics.chain import Frames, forward
from fsw.kinematics.transforms import Array, dot, rotate, rotate_back, skew

EQUILIBRIUM_TOLERANCE = 1e-11
MAX_PASSES = 30


@dataclass(frozen=True, slots=True, eq=False)
class Equilibrium:
    """The arm at rest under gravity."""

    output_rad: Array
    """Joint angles at the output, (5, ...)."""
    strain: Array
    """Spring displacements, (6, 6, ...), rotation first, links second."""
    torque_Nm: Array
    """Torque of the load on each joint's output, (5, ...)."""
    frames: Frames
    converged: Array
    """(...) bool."""


def load(arm: Arm, frames: Frames, strain: Array, gravity_R_m_s2: Array) -> tuple[Array, Array]:
    """The strain that the springs take under the load of these frames, and the joint torques.

    Paper equations 4 and 5, with the load at the deflected pose. Gravity (3,) or (3, ...) in the rover frame;
    strain (6, 6, ...) and torque (5, ...) out.
    """
    ones = (1,) * (strain.ndim - 2)
    g = gravity_R_m_s2.reshape(3, 1, *(gravity_R_m_s2.shape[1:] or ones))
    R_RL, X_LD, origin = frames.X_RL.R, frames.X_LD, frames.X_RL.p
    near = np.einsum("ijl...,jl->il...", R_RL, arm.near_p_L_m) + origin
    far_p_L = np.einsum("ijl...,jl->il...", X_LD.R, arm.far_p_C_m) + X_LD.p
    far, spring = rotate(R_RL, far_p_L) + origin, rotate(R_RL, X_LD.p) + origin
    near_kg, far_kg = (kg.reshape(1, 6, *ones) for kg in (arm.near_kg, arm.far_kg))
    near_kg_m = near_kg * near
    carried_kg_m = _outward_sum(near_kg_m + far_kg * far)
    carried_kg = _outward_sum(near_kg + far_kg)

    times_g = -skew(g)  # v x g = [-g] v
    spring_kg = carried_kg - near_kg
    moment = rotate(times_g, carried_kg_m - near_kg_m - spring_kg * spring)
    new_strain = _yield(arm, frames, rotate_back(R_RL, moment), rotate_back(R_RL, spring_kg * g))

    lever_kg_m = carried_kg_m[:, 1:] - carried_kg[:, 1:] * origin[:, 1:]
    torque = dot(rotate(times_g, lever_kg_m), R_RL[:, 2, 1:])
    return new_strain, torque


def _outward_sum(per_link: Array) -> Array:
    """For each link the sum over it and all links beyond, along axis 1."""
    total = np.array(per_link)
    for i in range(4, -1, -1):
        total[:, i] += total[:, i + 1]
    return total


def _yield(arm: Arm, frames: Frames, moment_L: Array, force_L: Array) -> Array:
    """Compliance times the load as the spring's own coordinates feel it: its later axes have turned.

    The axes are x, then y turned about x, then z turned about both, which is the far side's z axis.
    """
    z_axis = frames.X_LD.R[:, 2]
    moment = np.broadcast_to(moment_L, force_L.shape)
    wrench = np.empty((6, *force_L.shape[1:]))
    wrench[0] = moment[0]
    wrench[1] = (z_axis[2] * moment[1] - z_axis[1] * moment[2]) / np.sqrt(z_axis[1] ** 2 + z_axis[2] ** 2)
    wrench[2] = dot(z_axis, moment)
    wrench[3:] = force_L
    new_strain: Array = np.einsum("ijl,jl...->il...", arm.compliance, wrench)
    return new_strain


def settle(arm: Arm, motor_rad: Array, gap_rad: Array, gravity_R_m_s2: Array) -> Equilibrium:
    """The rest pose for motor angles and gaps (5, ...): output = motor + gap + torque / stiffness."""
    return _equilibrium(arm, motor_rad + gap_rad, 1.0 / arm.gear_stiffness_Nm_rad, gravity_R_m_s2)


def rest(arm: Arm, output_rad: Array, gravity_R_m_s2: Array) -> Equilibrium:
    """The rest pose for output angles (5, ...), whatever the gears do to hold them."""
    return _equilibrium(arm, output_rad, np.zeros_like(arm.gear_stiffness_Nm_rad), gravity_R_m_s2)


def _equilibrium(arm: Arm, anchor_rad: Array, gear_rad_Nm: Array, gravity_R_m_s2: Array) -> Equilibrium:
    """Fixed point of load and strain; each pass takes off a factor of twenty or more."""
    batch = anchor_rad.shape[1:]
    gear = gear_rad_Nm.reshape(5, *(1,) * len(batch))
    strain = np.zeros((6, 6, *batch))
    output = anchor_rad
    for _ in range(MAX_PASSES):
        frames = forward(arm, output, strain)
        new_strain, torque = load(arm, frames, strain, gravity_R_m_s2)
        new_output = anchor_rad + torque * gear
        step = np.maximum(
            np.max(np.abs(new_strain - strain), axis=(0, 1)), np.max(np.abs(new_output - output), axis=0)
        )
        strain, output = new_strain, new_output
        if np.all(step < EQUILIBRIUM_TOLERANCE):
            break
    return Equilibrium(output, strain, torque, forward(arm, output, strain), step < EQUILIBRIUM_TOLERANCE)
