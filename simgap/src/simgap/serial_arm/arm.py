"""Serial arm with any number of joints: six parameters for each link, and errors of the joints."""

from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
from pydantic import ConfigDict, Field

from simgap.arrays import Array

GEOMETRY_NAMES: Final = ("theta", "d", "beta", "b", "alpha", "a")
"""Geometric parameters of a link in the order of paper equation 1."""

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
        """Check that cosines and sines are equally many.

        Raises:
            ValueError: They are not.
        """
        if len(self.cos_rad or ()) != len(self.sin_rad or ()):
            raise ValueError(f"{self.name}: cos and sin are not equally many; give both, one for each order")

    @property
    def geometry(self) -> tuple[float, float, float, float, float, float]:
        """Return the geometric parameters in the order of GEOMETRY_NAMES."""
        return (self.theta_rad, self.d_m, self.beta_rad, self.b_m, self.alpha_rad, self.a_m)

    def periodic_rad(self, orders: int) -> Array:
        """Return the amplitudes of the periodic error, filled up with zeros.

        Args:
            orders: Number of orders.

        Returns:
            Amplitudes of cosines and sines [rad], shape (2, orders).
        """
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
