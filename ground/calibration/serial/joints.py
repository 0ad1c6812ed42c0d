"""How joints err from what they read: under load, from where they came, and wave by wave over a turn."""

from typing import Final

import numpy as np

from fsw.kinematics.transforms import IDENTITY, Array
from ground.calibration.serial.arm import SerialArm
from ground.calibration.serial.chain import batch, chain, load_torque_Nm
from ground.calibration.serial.series import Series

ALONE: Final = ("compliance", "approach")
"""The coefficients of a joint before those of its waves: all cosines, then all sines."""


def names(orders: int) -> list[str]:
    """Of a joint's coefficients."""
    return [*ALONE, *(f"{wave}{k + 1}" for wave in ("cos", "sin") for k in range(orders))]


def coefficients(arm: SerialArm, orders: int) -> Array:
    """Of all joints, (joints, 2 + 2 orders)."""
    return np.array(
        [[one.compliance_rad_per_Nm, one.approach_rad, *one.waves_rad(orders).ravel()] for one in arm.links]
    )


def features(arm: SerialArm, series: Series, orders: int) -> Array:
    """By what each coefficient is multiplied: torque, direction, waves; (joints, n, 2 + 2 orders)."""
    q = series.joint_rad
    ends, axes = chain(batch(IDENTITY, series.count), arm.sixes, q)
    masses = np.array([one.mass_kg for one in arm.links])
    centres = np.array([one.mass_centre_m for one in arm.links])
    torque = load_torque_Nm(ends, axes, masses, centres, np.array(arm.gravity_B_m_s2))
    phase = q[:, :, None] * np.arange(1, orders + 1)
    alone = np.stack([torque, series.came], axis=-1)
    return np.concatenate([alone, np.cos(phase), np.sin(phase)], axis=-1)


def errors_rad(arm: SerialArm, features: Array) -> Array:
    """How much farther the joints stand than they read, (joints, n)."""
    orders = (features.shape[2] - len(ALONE)) // 2
    errors: Array = np.einsum("jnk,jk->jn", features, coefficients(arm, orders))
    return errors
