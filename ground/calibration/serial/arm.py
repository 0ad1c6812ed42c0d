"""A serial arm of any number of joints: six numbers a link, and how its joints err from what they read."""

from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np

from fsw.dictionary.types import Limits
from fsw.kinematics.transforms import Array

GEOMETRY_NAMES: Final = ("theta", "d", "beta", "b", "alpha", "a")
"""A link's numbers, in the order of paper equation 1."""

Length = Annotated[float, Limits(-100.0, 100.0)]
Angle = Annotated[float, Limits(-100.0, 100.0)]
Sigma = Annotated[float, Limits(1e-9, 10.0)]


@dataclass(frozen=True, slots=True)
class Link:
    """A joint and the link that it turns: Rz(q + theta) Tz(d) Ry(beta) Ty(b) Rx(alpha) Tx(a)."""

    name: str
    theta_rad: Angle = 0.0
    d_m: Length = 0.0
    beta_rad: Angle = 0.0
    b_m: Length = 0.0
    alpha_rad: Angle = 0.0
    a_m: Length = 0.0
    mass_kg: Annotated[float, Limits(0.0, 1e4)] = 0.0
    mass_centre_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Centre of mass in the frame at the link's end."""
    compliance_rad_per_Nm: Annotated[float, Limits(-1.0, 1.0)] = 0.0
    """Turn of the joint for a load torque about it."""
    approach_rad: Annotated[float, Limits(-1.0, 1.0)] = 0.0
    """How much farther the joint stands after a move in its positive direction, and less after one back."""
    cos_rad: tuple[float, ...] | None = None
    """How much farther it stands, turn for turn: sum of cos[k] cos((k + 1) q) + sin[k] sin((k + 1) q)."""
    sin_rad: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        """See that waves have both their parts."""
        if len(self.cos_rad or ()) != len(self.sin_rad or ()):
            raise ValueError(f"{self.name}: cos and sin are not equally many; give both, one for each order")

    @property
    def geometry(self) -> tuple[float, float, float, float, float, float]:
        """In the order of SIX."""
        return (self.theta_rad, self.d_m, self.beta_rad, self.b_m, self.alpha_rad, self.a_m)

    def periodic_rad(self, orders: int) -> Array:
        """Amplitudes (2, orders) of cosines and sines."""
        both = np.zeros((2, orders))
        for row, said in zip(both, (self.cos_rad or (), self.sin_rad or ()), strict=True):
            row[: len(said)] = said[:orders]
        return both


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """How far an arm that was built may be from the numbers of its file, one sigma each."""

    length_m: Sigma = 1e-3
    angle_rad: Sigma = 2e-3
    compliance_rad_per_Nm: Sigma = 1e-4
    approach_rad: Sigma = 3e-4
    wave_rad: Sigma = 3e-5
    """Of each cosine and sine."""
    orders: Annotated[int, Limits(0, 500)] = 48
    """Waves in a turn, of the shortest that is looked for."""


@dataclass(frozen=True, slots=True)
class Repeatability:
    """How well the arm comes back to a pose and is measured there, one sigma an axis."""

    position_m: Sigma = 1e-4
    rotation_rad: Sigma = 4e-4


@dataclass(frozen=True, slots=True)
class SerialArm:
    """Links from the base outward; the last one ends at the flange."""

    name: str
    links: tuple[Link, ...]
    gravity_B_m_s2: tuple[float, float, float] = (0.0, 0.0, -9.80665)
    """In the base frame, about whose z axis the first joint turns."""
    uncertain: Uncertainty = Uncertainty()
    repeats: Repeatability = Repeatability()

    @property
    def link_geometry(self) -> Array:
        """Six numbers of every link, (joints, 6)."""
        return np.array([one.geometry for one in self.links])

    @property
    def orders(self) -> int:
        """Waves in a turn that any joint has amplitudes for."""
        return max((len(link.cos_rad or ()) for link in self.links), default=0)
