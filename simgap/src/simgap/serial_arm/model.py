"""Serial arm with any number of joints, and measured poses as a function of the parameters to fit.

Values of parameters are arrays (p,) in their units.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Final

import numpy as np
from pydantic import ConfigDict, Field

from simgap.arrays import Array
from simgap.serial_arm import chain
from simgap.serial_arm.fit import FitParameter, Linearisation

GEOMETRY_NAMES: Final = ("theta", "d", "beta", "b", "alpha", "a")
"""Geometric parameters of a link in the order of paper equation 1."""
GEOMETRY_FIELDS: Final = ("theta_rad", "d_m", "beta_rad", "b_m", "alpha_rad", "a_m")

Length = Annotated[float, Field(strict=True, ge=-100.0, le=100.0)]
Angle = Annotated[float, Field(strict=True, ge=-100.0, le=100.0)]
Sigma = Annotated[float, Field(strict=True, ge=1e-9, le=10.0)]
Number = Annotated[float, Field(strict=True)]
Vector = tuple[Number, Number, Number]
UPRIGHT_B_m_s2: Final = (0.0, 0.0, -9.80665)
"""Gravity on Earth, of an arm that stands upright."""
TABLE: Final = ConfigDict(extra="forbid", allow_inf_nan=False)
"""Rules for reading these records from a file."""


@dataclass(frozen=True, slots=True)
class Link:
    """Joint with the link that it rotates: Rz(q + theta) Tz(d) Ry(beta) Ty(b) Rx(alpha) Tx(a)."""

    __pydantic_config__ = TABLE

    name: str
    theta_rad: Angle = 0.0
    d_m: Length = 0.0
    beta_rad: Angle = 0.0
    b_m: Length = 0.0
    alpha_rad: Angle = 0.0
    a_m: Length = 0.0
    mass_kg: Annotated[float, Field(strict=True, ge=0.0, le=1e4)] = 0.0
    mass_centre_m: Vector = (0.0, 0.0, 0.0)
    """Centre of mass in the frame at the end of the link."""
    compliance_rad_per_Nm: Annotated[float, Field(strict=True, ge=-1.0, le=1.0)] = 0.0
    """Rotation of the joint for each newton metre of load torque."""
    hysteresis_rad: Annotated[float, Field(strict=True, ge=-1.0, le=1.0)] = 0.0
    """Direction hysteresis: true less read angle after a positive move; negated after a negative one."""
    cos_rad: tuple[Number, ...] | None = None
    """Periodic error, true less read angle: sum of cos[k] cos((k + 1) q) + sin[k] sin((k + 1) q)."""
    sin_rad: tuple[Number, ...] | None = None

    def __post_init__(self) -> None:
        """Refuse cosines and sines that are not equally many."""
        if len(self.cos_rad or ()) != len(self.sin_rad or ()):
            raise ValueError(f"{self.name}: cos and sin are not equally many; give both, one for each order")

    @property
    def geometry(self) -> tuple[float, ...]:
        """Return the geometric parameters in the order of GEOMETRY_NAMES."""
        return tuple(getattr(self, name) for name in GEOMETRY_FIELDS)

    def periodic_rad(self, orders: int) -> Array:
        """Return amplitudes of cosines and sines [rad], shape (2, orders), filled up with zeros."""
        both = np.zeros((2, orders))
        for row, given in zip(both, (self.cos_rad or (), self.sin_rad or ()), strict=True):
            row[: len(given)] = given[:orders]
        return both


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Tolerances of a built arm relative to the parameters of its file, one sigma each."""

    __pydantic_config__ = TABLE

    length_m: Sigma = 1e-3
    angle_rad: Sigma = 2e-3
    compliance_rad_per_Nm: Sigma = 1e-4
    hysteresis_rad: Sigma = 3e-4
    periodic_rad: Sigma = 3e-5
    """Sigma of each cosine and sine of the periodic error."""
    orders: Annotated[int, Field(strict=True, ge=0, le=500)] = 48
    """Highest order of the periodic error, in periods a turn."""


@dataclass(frozen=True, slots=True)
class Repeatability:
    """Repeatability of a measured pose, one sigma an axis."""

    __pydantic_config__ = TABLE

    position_m: Sigma = 1e-4
    rotation_rad: Sigma = 4e-4


@dataclass(frozen=True, slots=True)
class SerialArm:
    """Links from the base outward; the last one ends at the flange."""

    name: str
    links: tuple[Link, ...]
    gravity_B_m_s2: Vector = UPRIGHT_B_m_s2
    """Gravity in the base frame; the first joint rotates about z of this frame."""
    uncertainty: Uncertainty = Uncertainty()
    repeatability: Repeatability = Repeatability()

    @property
    def link_geometry(self) -> Array:
        """Return the geometric parameters of every link, shape (joints, 6)."""
        return np.array([one.geometry for one in self.links])

    @property
    def orders(self) -> int:
        """Return the highest order of a periodic error that any joint has."""
        return max((len(link.cos_rad or ()) for link in self.links), default=0)


NON_PERIODIC: Final = ("compliance", "hysteresis")
"""Coefficients of a joint before those of its periodic error, which are all cosines, then all sines."""
GEOMETRY: Final = "geometry"
COMPLIANCE: Final = "compliance"
PERIODIC: Final = "periodic"
HYSTERESIS: Final = "hysteresis"
TERMS: Final = (GEOMETRY, COMPLIANCE, PERIODIC, HYSTERESIS)
"""Optional terms of a fit. Base and target frames are always fitted."""


def coefficient_names(orders: int) -> list[str]:
    """List the names of a joint's coefficients."""
    return [*NON_PERIODIC, *(f"{wave}{k + 1}" for wave in ("cos", "sin") for k in range(orders))]


def joint_coefficients(arm: SerialArm, orders: int) -> Array:
    """Collect the coefficients of all joints [rad/(N m), rad], (joints, 2 + 2 orders)."""
    return np.array(
        [
            [one.compliance_rad_per_Nm, one.hysteresis_rad, *one.periodic_rad(orders).ravel()]
            for one in arm.links
        ]
    )


def features(arm: SerialArm, series: chain.PoseSeries, orders: int) -> Array:
    """Compute the factors of all coefficients: torque, last direction, waves, (joints, n, 2 + 2 orders)."""
    q = series.joint_rad
    start = chain.repeat_pose(chain.IDENTITY, series.count)
    ends, axes = chain.forward_kinematics(start, arm.link_geometry, q)
    masses = np.array([one.mass_kg for one in arm.links])
    centres = np.array([one.mass_centre_m for one in arm.links])
    torque = chain.load_torque_Nm(ends, axes, masses, centres, np.array(arm.gravity_B_m_s2))
    phase = q[:, :, None] * np.arange(1, orders + 1)
    non_periodic = np.stack([torque, series.direction], axis=-1)
    return np.concatenate([non_periodic, np.cos(phase), np.sin(phase)], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class TrackerSetup:
    """Frames of base and target in one series."""

    X_TB: chain.Pose
    """Base of the arm in the tracker's frame."""
    X_FM: chain.Pose
    """Target of the tracker in the flange frame."""


@dataclass(frozen=True, slots=True, eq=False)
class SerialModel:
    """Residual model of a series with the parameters of some terms."""

    arm: SerialArm
    """Arm before the calibration."""
    setup: TrackerSetup
    series: chain.PoseSeries
    terms: tuple[str, ...]
    orders: int
    features: Array
    """Factors of the joint coefficients, from `features`, shape (joints, n, 2 + 2 orders)."""

    @property
    def parameters(self) -> list[FitParameter]:
        """List the parameters in the order of the values: base, target, links, coefficients of the joints."""
        tolerance = self.arm.uncertainty
        sizes = (tolerance.angle_rad, tolerance.length_m)
        places = [(place, name) for place in ("base", "target") for name in GEOMETRY_NAMES]
        found = [_geometry_parameter(*one, *sizes) for one in places]
        if GEOMETRY in self.terms:
            links = ((one.name, name) for one in self.arm.links for name in GEOMETRY_NAMES)
            found += [_with_prior(_geometry_parameter(*which, *sizes)) for which in links]
        non_periodic = [tolerance.compliance_rad_per_Nm, tolerance.hysteresis_rad]
        sigmas = np.array([*non_periodic, *[tolerance.periodic_rad] * (2 * self.orders)])
        names = coefficient_names(self.orders)
        for one in self.arm.links:
            for k in self._chosen:
                unit = "rad/(N m)" if k == 0 else "rad"
                found.append(_with_prior(FitParameter(f"{one.name}.{names[k]}", unit, float(sigmas[k]))))
        return found

    @property
    def _chosen(self) -> list[int]:
        """List the indices of the joint coefficients to fit."""
        non_periodic = [k for k, name in enumerate(NON_PERIODIC) if name in self.terms]
        waves = range(len(NON_PERIODIC), len(NON_PERIODIC) + 2 * self.orders)
        return [*non_periodic, *(waves if PERIODIC in self.terms else ())]

    def at(self, values: Array) -> tuple[SerialArm, TrackerSetup]:
        """Apply parameter values."""
        shape = (len(self.arm.links), 6)
        geometry, rest = np.zeros(shape), values[12:]
        if GEOMETRY in self.terms:
            geometry, rest = rest[: geometry.size].reshape(shape), rest[geometry.size :]
        errors = joint_coefficients(self.arm, self.orders)
        errors[:, self._chosen] += rest.reshape(len(self.arm.links), -1)
        links = (_update_link(*changed) for changed in zip(self.arm.links, geometry, errors, strict=True))
        X_TB, X_FM = _move_frame(self.setup.X_TB, values[:6]), _move_frame(self.setup.X_FM, values[6:12])
        setup = TrackerSetup(X_TB, X_FM)
        return replace(self.arm, links=tuple(links)), setup

    def poses(self, values: Array) -> chain.Pose:
        """Compute X_TM, the modelled poses of the target in the tracker's frame, batch (n,)."""
        return self._chain(values)[0]

    def _chain(self, values: Array) -> tuple[chain.Pose, list[chain.LinkAxes]]:
        """Compute X_TM, and the axes of base, target and links."""
        n = self.series.count
        arm, _ = self.at(values)
        still = np.zeros(n)
        X_B, base = chain.link_transform(chain.repeat_pose(self.setup.X_TB, n), still, values[:6])
        errors_rad = np.einsum("jnk,jk->jn", self.features, joint_coefficients(arm, self.orders))
        turn = self.series.joint_rad + errors_rad  # true angles, by those that were read
        ends, axes = chain.forward_kinematics(X_B, arm.link_geometry, turn)
        placed = ends[-1] @ chain.repeat_pose(self.setup.X_FM, n)
        X_M, target = chain.link_transform(placed, still, values[6:12])
        return X_M, [base, target, *axes]

    def __call__(self, values: Array) -> Linearisation:
        """Compute whitened error screws, (n, 6), and their derivatives, (n, 6, p)."""
        X_M, axes = self._chain(values)
        screws = [one.screws(X_M) for one in axes]
        columns = screws if GEOMETRY in self.terms else screws[:2]
        chosen = self._chosen
        joint_columns = [
            screw[:, :, :1] * phi[None, :, chosen]
            for screw, phi in zip(screws[2:], self.features, strict=True)
        ]
        jacobian = np.concatenate([*columns, *joint_columns], axis=2)
        noise = self.arm.repeatability
        inverse = np.diag(1.0 / np.repeat([noise.rotation_rad, noise.position_m], 3))
        whitener = np.broadcast_to(inverse, (self.series.count, 6, 6))
        return chain.linearise(X_M, jacobian, self.series.X_TM, whitener)


def serial_model(
    arm: SerialArm, setup: TrackerSetup, series: chain.PoseSeries, terms: Sequence[str]
) -> SerialModel:
    """Build the residual model of a series; effects of the arm that are not fitted stay in the model."""
    orders = max(arm.orders, arm.uncertainty.orders if PERIODIC in terms else 0)
    return SerialModel(arm, setup, series, tuple(terms), orders, features(arm, series, orders))


def _geometry_parameter(place: str, name: str, angle: float, length: float) -> FitParameter:
    turns = name in ("theta", "beta", "alpha")
    return FitParameter(f"{place}.{name}", "rad" if turns else "m", angle if turns else length)


def _with_prior(parameter: FitParameter) -> FitParameter:
    """Set the prior sigma of a parameter to its scale."""
    return replace(parameter, prior_sigma=parameter.scale)


def _update_link(one: Link, geometry: Array, errors: Array) -> Link:
    moved = (np.array(one.geometry) + geometry).tolist()
    fields: dict[str, Any] = dict(zip(GEOMETRY_FIELDS, moved, strict=True))
    fields |= {"compliance_rad_per_Nm": float(errors[0]), "hysteresis_rad": float(errors[1])}
    orders = (errors.size - len(NON_PERIODIC)) // 2
    waves = errors[len(NON_PERIODIC) :].reshape(2, orders).tolist()
    cos, sin = (tuple(one) or None for one in waves)
    return replace(one, cos_rad=cos, sin_rad=sin, **fields)


def _move_frame(X: chain.Pose, geometry: Array) -> chain.Pose:
    return chain.link_transform(chain.repeat_pose(X, 1), np.zeros(1), geometry)[0][0]
