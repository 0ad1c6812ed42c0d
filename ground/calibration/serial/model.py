"""A serial arm as the engine's model: how its measured poses depend on what is to be found."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Pose
from ground.calibration.problem import Linearised, Parameter
from ground.calibration.screws import Measured, linearised
from ground.calibration.serial.arm import SIX, Link, SerialArm
from ground.calibration.serial.chain import Axes, batch, chain, link
from ground.calibration.serial.joints import ALONE, coefficients, errors_rad, features, names
from ground.calibration.serial.series import Series

GEOMETRY: Final = "geometry"
COMPLIANCE: Final = "compliance"
WAVES: Final = "waves"
APPROACH: Final = "approach"
TERMS: Final = (GEOMETRY, COMPLIANCE, WAVES, APPROACH)
"""What may be found of an arm; where its base and its target are is always found."""


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """Where the arm stands and what it holds, of one series."""

    X_TB: Pose
    """The arm's base in the tracker's frame."""
    X_FM: Pose
    """The tracker's target in the flange's frame."""


@dataclass(frozen=True, slots=True, eq=False)
class SerialModel:
    """Whitened error screws of a series, for the parameters of some terms: the engine's Model."""

    arm: SerialArm
    """As it is believed to be."""
    setup: Setup
    series: Series
    terms: tuple[str, ...]
    orders: int
    features: Array
    """Of joints.py."""

    @property
    def parameters(self) -> list[Parameter]:
        """In the order of the values: base, target, links, coefficients of the joints."""
        sure = self.arm.uncertain
        sizes = (sure.angle_rad, sure.length_m)
        found = [_one(place, name, *sizes) for place in ("base", "target") for name in SIX]
        if GEOMETRY in self.terms:
            links = ((one.name, name) for one in self.arm.links for name in SIX)
            found += [_believed(_one(*which, *sizes)) for which in links]
        alone = [sure.compliance_rad_per_Nm, sure.approach_rad]
        sigmas = np.array([*alone, *[sure.wave_rad] * (2 * self.orders)])
        said = names(self.orders)
        for one in self.arm.links:
            for k in self._chosen:
                unit = "rad/(N m)" if k == 0 else "rad"
                found.append(_believed(Parameter(f"{one.name}.{said[k]}", unit, float(sigmas[k]))))
        return found

    @property
    def _chosen(self) -> list[int]:
        """Which coefficients of a joint are to be found."""
        alone = [k for k, name in enumerate(ALONE) if name in self.terms]
        waves = range(len(ALONE), len(ALONE) + 2 * self.orders)
        return [*alone, *(waves if WAVES in self.terms else ())]

    def at(self, values: Array) -> tuple[SerialArm, Setup]:
        """The arm and the set-up that values (p,) of the parameters mean."""
        shape = (len(self.arm.links), 6)
        sixes, rest = np.zeros(shape), values[12:]
        if GEOMETRY in self.terms:
            sixes, rest = rest[: sixes.size].reshape(shape), rest[sixes.size :]
        errors = coefficients(self.arm, self.orders)
        errors[:, self._chosen] += rest.reshape(len(self.arm.links), -1)
        links = (_moved(*changed) for changed in zip(self.arm.links, sixes, errors, strict=True))
        setup = Setup(_ended(self.setup.X_TB, values[:6]), _ended(self.setup.X_FM, values[6:12]))
        return replace(self.arm, links=tuple(links)), setup

    def poses(self, values: Array) -> Pose:
        """X_TM as the model has it, batch (n,)."""
        return self._chain(values)[0]

    def _chain(self, values: Array) -> tuple[Pose, list[Axes]]:
        """X_TM, and the axes of the base, the target and the links."""
        n = self.series.count
        arm, _ = self.at(values)
        still = np.zeros(n)
        X_B, base = link(batch(self.setup.X_TB, n), still, values[:6])
        turn = self.series.joint_rad + errors_rad(arm, self.features)
        ends, axes = chain(X_B, arm.sixes, turn)
        X_M, target = link(ends[-1] @ batch(self.setup.X_FM, n), still, values[6:12])
        return X_M, [base, target, *axes]

    def __call__(self, values: Array) -> Linearised:
        """Residuals (n, 6) and their derivatives (n, 6, p)."""
        X_M, axes = self._chain(values)
        screws = [one.screws(X_M) for one in axes]
        moved = screws if GEOMETRY in self.terms else screws[:2]
        chosen = self._chosen
        turned = [
            screw[:, :, :1] * phi[None, :, chosen]
            for screw, phi in zip(screws[2:], self.features, strict=True)
        ]
        return linearised(X_M, np.concatenate([*moved, *turned], axis=2), self._measured())

    def _measured(self) -> Measured:
        noise = self.arm.repeats
        variance = np.repeat([noise.rotation_rad**2, noise.position_m**2], 3)
        return Measured(self.series.X_TM, np.broadcast_to(np.diag(variance), (self.series.count, 6, 6)))


def serial_model(arm: SerialArm, setup: Setup, series: Series, terms: Sequence[str]) -> SerialModel:
    """The model of a series with these terms to be found; what the arm is believed to have stays in it."""
    orders = max(arm.orders, arm.uncertain.orders if WAVES in terms else 0)
    return SerialModel(arm, setup, series, tuple(terms), orders, features(arm, series, orders))


def _one(place: str, name: str, angle: float, length: float) -> Parameter:
    turns = name in ("theta", "beta", "alpha")
    return Parameter(f"{place}.{name}", "rad" if turns else "m", angle if turns else length)


def _believed(parameter: Parameter) -> Parameter:
    """What is expected to be within its scale."""
    return replace(parameter, prior_sigma=parameter.scale)


def _moved(one: Link, six: Array, errors: Array) -> Link:
    theta, d, beta, b, alpha, a = (float(v) for v in np.array(one.six) + six)
    orders = (errors.size - len(ALONE)) // 2
    cos, sin = (tuple(float(v) for v in part) or None for part in errors[len(ALONE) :].reshape(2, orders))
    return replace(
        one,
        theta_rad=theta,
        d_m=d,
        beta_rad=beta,
        b_m=b,
        alpha_rad=alpha,
        a_m=a,
        compliance_rad_per_Nm=float(errors[0]),
        approach_rad=float(errors[1]),
        cos_rad=cos,
        sin_rad=sin,
    )


def _ended(X: Pose, six: Array) -> Pose:
    return link(batch(X, 1), np.zeros(1), six)[0][0]
