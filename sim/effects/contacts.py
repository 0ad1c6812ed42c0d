"""What the tools touch."""

from dataclasses import dataclass
from typing import Annotated

import mujoco
import numpy as np

from sim.effects.effect import Effect
from sim.effects.size import Size


@dataclass(frozen=True, slots=True)
class ContactStiffness(Effect):
    """What is touched is so many times as stiff under a pad."""

    factor: Annotated[float, Size(0.05, 20.0, unit="1", typical=0.5, neutral=1.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Pads have their stiffness and damping in MuJoCo's direct format; the damping ratio stays."""
        for geom in spec.geoms:
            if geom.name.endswith("_pad"):
                geom.solref = geom.solref * np.array([self.factor, self.factor**0.5])


@dataclass(frozen=True, slots=True)
class SurfacePosition(Effect):
    """The rock's face is nearer than it was seen, along its normal."""

    offset_m: Annotated[float, Size(-0.05, 0.05, unit="m", typical=3e-3, neutral=0.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Shift the rock, if there is one."""
        rock = spec.body("rock")
        if rock is not None:
            R = np.zeros(9)
            mujoco.mju_quat2Mat(R, rock.quat)
            rock.pos = rock.pos + self.offset_m * R.reshape(3, 3)[:, 2]
