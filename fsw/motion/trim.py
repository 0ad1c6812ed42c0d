"""What the motors' currents tell of a press, and the change of force that follows from it.

Along the overdrive the load of the joints rises in proportion to the force. How steeply it rises in the
currents, against how steeply the model has it, is the ratio of true to modelled stiffness; friction, weight
and bias do not change on the way and drop out.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.transforms import Array
from fsw.messages import Sensors
from fsw.motion.paths import Setpoint
from fsw.motion.plan_press import Press, Pressing

LEVER_SHARE: Final = 0.3
"""Joints with less of the largest lever say little."""
MOVING_RAD_S: Final = 5e-5
"""Slower, friction is not what it is in motion."""
BELIEVABLE: Final = (0.5, 2.0)
FEWEST: Final = 64
NARROWEST_N: Final = 150.0
"""Of the forces that are compared: over less, gaps and gears that are crossed on the way weigh too much."""


@dataclass(frozen=True, slots=True)
class PressFit:
    """Sums over the cycles of a press, of modelled force x and felt force y, in newtons."""

    n: int = 0
    x: float = 0.0
    y: float = 0.0
    xx: float = 0.0
    xy: float = 0.0
    least_N: float = np.inf
    most_N: float = -np.inf

    def slope(self) -> float | None:
        """How much force there is for a newton of the model; None if too little was felt."""
        if self.n < FEWEST or self.most_N - self.least_N < NARROWEST_N:
            return None
        spread = self.n * self.xx - self.x**2
        slope = (self.n * self.xy - self.x * self.y) / spread
        return slope if BELIEVABLE[0] < slope < BELIEVABLE[1] else None


def fitted(
    config: Config,
    last: PressFit,
    press: Press,
    pressing: Pressing,
    hold: Setpoint,
    joints: JointEstimate,
    load_Nm: Array,
    sensors: Sensors,
) -> PressFit:
    """The fit with this cycle's currents, if all joints that have leverage are moving."""
    lever = np.abs(press.torque_per_N)
    says = lever >= LEVER_SHARE * lever.max()
    if not np.all(np.abs(hold.rate_rad_s[says]) > MOVING_RAD_S):
        return last
    per_N = press.torque_per_N[says]
    friction = joints.reference.friction_Nm[says]
    resisting = np.where(np.isfinite(friction), friction, 0.0) * np.sign(hold.rate_rad_s[says])
    carried = resisting - (config.torque_constant_Nm_A * sensors.current_A)[says]
    x = pressing.force_N
    y = x + float(per_N @ (carried - load_Nm[says]) / (per_N @ per_N))
    return PressFit(
        n=last.n + 1,
        x=last.x + x,
        y=last.y + y,
        xx=last.xx + x * x,
        xy=last.xy + x * y,
        least_N=min(last.least_N, x),
        most_N=max(last.most_N, x),
    )


def modelled_force(press: Press, fit: PressFit) -> float | None:
    """The force of the model at which the true one is as wanted; None where nothing is known of it."""
    slope = fit.slope()
    if slope is None or press.end_N <= press.start.force_N:
        return None
    return press.start.force_N + (press.end_N - press.start.force_N) / slope
