"""How much each effect that was found amounts to: at the target, and at the joints."""

from dataclasses import dataclass

import numpy as np

from fsw.kinematics.transforms import Array
from ground.calibration.serial.calibrate import Calibrated
from ground.calibration.serial.joints import ALONE
from ground.calibration.serial.model import GEOMETRY, WAVES

NOT_LINKS = ("base", "target")


@dataclass(frozen=True, slots=True, eq=False)
class JointError:
    """What was found of one joint."""

    name: str
    compliance_rad_per_Nm: float
    compliance_sigma: float
    approach_rad: float
    approach_sigma: float
    rms_rad: float
    """Of its waves at the angles of the poses."""
    peak_rad: float
    """Largest of them."""


def moved_m(found: Calibrated) -> dict[str, float]:
    """By how much each term moves the target, root mean square over the poses of the fit."""
    fit, sigma_m = found.fit, found.model.arm.repeats.position_m
    J = fit.at.jacobian[:, 3:]
    names = [parameter.name.split(".") for parameter in fit.parameters]
    amounts = {}
    for term in found.model.terms:
        mine = np.array([_term(*name) == term for name in names])
        shift = J[:, :, mine] @ fit.values[mine] * sigma_m
        amounts[term] = float(np.sqrt(np.mean(np.sum(shift**2, axis=1))))
    return amounts


def _term(place: str, number: str) -> str | None:
    """Which term a parameter is of; base and target are of none."""
    if place in NOT_LINKS:
        return None
    if number in ALONE:
        return number
    return WAVES if number.startswith(("cos", "sin")) else GEOMETRY


def joint_errors(found: Calibrated) -> tuple[JointError, ...]:
    """Of all joints, from the base outward."""
    arm, fit = found.arm, found.fit
    sigma = {parameter.name: float(s) for parameter, s in zip(fit.parameters, fit.sigma, strict=True)}
    errors = []
    for one, features in zip(arm.links, found.model.features, strict=True):
        waves = wave_rad(features[:, len(ALONE) :], one.waves_rad(found.model.orders))
        errors.append(
            JointError(
                one.name,
                one.compliance_rad_per_Nm,
                sigma.get(f"{one.name}.compliance", 0.0),
                one.approach_rad,
                sigma.get(f"{one.name}.approach", 0.0),
                float(np.sqrt(np.mean(waves**2))),
                float(np.max(np.abs(waves))),
            )
        )
    return tuple(errors)


def wave_rad(features: Array, amplitudes: Array) -> Array:
    """A joint's waves (n,), from cosines and sines (n, 2 orders) and their amplitudes (2, orders)."""
    waves: Array = features @ amplitudes.ravel()
    return waves
