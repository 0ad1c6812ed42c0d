"""What the motors' currents tell of a press, and the change of force that follows from it.

Between the first and the last newtons of the overdrive the load of every joint rises by what the rock gives
back; friction, weight and bias are the same at both ends and drop out. Five loads against a force of three
components: what is felt along the tool's axis for a newton of the model, and what across.
"""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.chain import joint_jacobian, tool_pose
from fsw.kinematics.statics import rest
from fsw.kinematics.transforms import Array
from fsw.messages import Sensors
from fsw.motion.paths import Setpoint
from fsw.motion.plan_press import Press, Pressing

END_SHARE: Final = 0.25
"""Of the change of force, at either end, over which is averaged."""
BRISK_SHARE: Final = 0.75
"""Of its highest rate that the force must rise with: slower, friction is not what it is in motion."""
MOVING_RAD_S: Final = 5e-5
"""Slower, a joint says nothing."""
READING_NM: Final = 8.0
"""Noise of a load that one reading of a current tells."""
ACROSS: Final = 0.3
"""Of a newton of the model, so much may well be felt across."""
CROSSED_NM: Final = 3.0
"""What gaps that are crossed earlier or later than believed leave of the rise of a load."""
SUREST: Final = 0.05
BELIEVABLE: Final = (0.5, 2.0)


@dataclass(frozen=True, slots=True, eq=False)
class PressEnd:
    """Sums over the cycles at one end of a press."""

    n: int = 0
    model_N: float = 0.0
    push_Nm: Array = field(default_factory=lambda: np.zeros(5))
    """What the push of the rock loads the joints with, as the currents tell."""
    slowest_rad_s: Array = field(default_factory=lambda: np.full(5, np.inf))

    def after(self, model_N: float, push_Nm: Array, rate_rad_s: Array) -> "PressEnd":
        """One cycle more."""
        slowest = np.minimum(self.slowest_rad_s, np.abs(rate_rad_s))
        return PressEnd(self.n + 1, self.model_N + model_N, self.push_Nm + push_Nm, slowest)


@dataclass(frozen=True, slots=True, eq=False)
class PressFit:
    """Both ends of a leg of a press, and how many legs may follow."""

    legs: int = 2
    first: PressEnd = field(default_factory=PressEnd)
    last: PressEnd = field(default_factory=PressEnd)


@dataclass(frozen=True, slots=True)
class FeltShare:
    """What is felt for a newton of the model."""

    along: float
    across: float
    unsure: float
    """Standard deviation of the first."""


def fitted(
    config: Config,
    fit: PressFit,
    press: Press,
    pressing: Pressing,
    rate_N_s: float,
    hold: Setpoint,
    joints: JointEstimate,
    load_Nm: Array,
    sensors: Sensors,
) -> PressFit:
    """The fit with this cycle's currents, if the force is near one of the press's ends and rises briskly."""
    gone = (pressing.model_N - press.start.model_N) / press.change_N
    brisk = rate_N_s > BRISK_SHARE * config.params.preload.rate_N_s
    if not brisk or END_SHARE < gone < 1 - END_SHARE:
        return fit
    friction = joints.reference.friction_Nm
    resisting = np.where(np.isfinite(friction), friction, 0.0) * np.sign(hold.rate_rad_s)
    carried = resisting - config.torque_constant_Nm_A * sensors.current_A
    push = carried - load_Nm + press.torque_per_N * pressing.force_N
    if gone <= END_SHARE:
        return replace(fit, first=fit.first.after(pressing.model_N, push, hold.rate_rad_s))
    return replace(fit, last=fit.last.after(pressing.model_N, push, hold.rate_rad_s))


def felt_share(config: Config, fit: PressFit, joints: JointEstimate, pressing: Pressing) -> FeltShare | None:
    """What the rock gives back for a newton of the model; None if that cannot be.

    The likeliest of what was likely beforehand and of what the joints that moved tell, by its noise.
    """
    first, last = fit.first, fit.last
    if min(first.n, last.n) == 0:
        return None
    rise_N = last.model_N / last.n - first.model_N / first.n
    rise_Nm = last.push_Nm / last.n - first.push_Nm / first.n
    says = np.minimum(first.slowest_rad_s, last.slowest_rad_s) > MOVING_RAD_S
    levers = rise_N * _levers(config, joints, pressing)[says]
    variance_Nm2 = CROSSED_NM**2 + READING_NM**2 * (1 / first.n + 1 / last.n)
    likely = np.array([pressing.share, 0.0, 0.0])
    spread = np.array([pressing.share_unsure, ACROSS, ACROSS])
    information = np.diag(spread**-2) + levers.T @ levers / variance_Nm2
    surprise = levers.T @ (rise_Nm[says] - levers @ likely) / variance_Nm2
    along, *across = likely + np.linalg.solve(information, surprise)
    unsure = max(float(np.sqrt(np.linalg.inv(information)[0, 0])), SUREST)
    believable = BELIEVABLE[0] < along < BELIEVABLE[1]
    return FeltShare(float(along), float(np.hypot(*across)), unsure) if believable else None


def _levers(config: Config, joints: JointEstimate, pressing: Pressing) -> Array:
    """Loads (5, 3) by a newton against the tool's x axis, and by one along its y and z axes."""
    frames = rest(config.arm, joints.output_rad, joints.gravity_R_m_s2, pressing.pushed).frames
    X_RT = tool_pose(config.arm, frames, pressing.tool)
    levers: Array = joint_jacobian(frames, X_RT.p)[3:].T @ (X_RT.R * np.array([-1.0, 1.0, 1.0]))
    return levers


def corrected(press: Press, felt: FeltShare) -> Pressing:
    """What is pressed with at the end of a press, by what was felt on the way."""
    force_N = press.start.force_N + felt.along * press.change_N
    done = replace(press.start, model_N=press.end_model_N)
    return replace(done, share=force_N / press.end_model_N, share_unsure=felt.unsure)
