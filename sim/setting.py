"""Setting of a run: the scene, the tilt of the rover, and the rock face to touch."""

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from fsw.dictionary.types import Direction, Position
from fsw.kinematics.transforms import Array
from sim.frames import gravity_in_rover

Scene = Literal["mars", "earth"]
GRAVITY_M_S2: Final = {"mars": 3.711, "earth": 9.81}
BELOW_ROCK_M: Final = 0.1
MAX_TILT_RAD: Final = float(np.radians(30.0))
WARM_C: Final = 20.0
"""Temperature of an arm for which no effect sets another."""


@dataclass(frozen=True, slots=True)
class Surface:
    """Plane rock face through a point in RNAV; the normal points out of the rock."""

    p_N_m: Position
    normal_N: Direction


@dataclass(frozen=True, slots=True)
class World:
    """Surroundings of the arm."""

    scene: Scene = "mars"
    tilt_roll_rad: float = 0.0
    tilt_pitch_rad: float = 0.0
    surface: Surface | None = None

    @property
    def gravity_N_m_s2(self) -> Array:
        """Return gravity in RNAV (and RMECH) axes, shape (3,)."""
        return gravity_in_rover(self.tilt_roll_rad, self.tilt_pitch_rad, GRAVITY_M_S2[self.scene])

    @property
    def ground_N_m(self) -> float:
        """Return the height of the ground in RNAV, z down; it is below a low surface."""
        return 0.0 if self.surface is None else max(0.0, self.surface.p_N_m[2] + BELOW_ROCK_M)

    @property
    def tilt_rad(self) -> float:
        """Return the angle between the down axis of the rover and gravity."""
        return float(np.arccos(np.clip(np.cos(self.tilt_roll_rad) * np.cos(self.tilt_pitch_rad), -1.0, 1.0)))
