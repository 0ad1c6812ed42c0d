"""What the motors' currents tell of a press, and the change of force that follows from it.

While the overdrive grows, the load of every joint rises by what the rock gives back; friction, weight and
bias stay what they are and drop out. Five loads against a force of three components and a torque about the
tool's axis: an arm of five joints cannot keep a tool from turning about that axis, so the pads slide, and
their friction resists.
"""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.estimate.gear import LIKELY
from fsw.estimate.joints import JointEstimate, LoadEstimate
from fsw.kinematics.chain import joint_jacobian, tool_pose
from fsw.kinematics.statics import held_on_flank, settle_output
from fsw.kinematics.transforms import Array
from fsw.messages import Flags, Sensors
from fsw.motion.paths import Setpoint
from fsw.motion.plan_press import Press, Pressing

BRISK_SHARE: Final = 0.75
"""Of its highest rate that the force must rise with: slower, friction is not what it is in motion."""
READING_A: Final = 0.02
"""Noise of one reading of a current."""
ACROSS: Final = 0.3
"""Of a newton of the model, so much may well be felt across."""
TWIST_M: Final = 0.0225
"""Torque about the axis that pads 45 mm off it, with a friction coefficient of 0.5, pass on for a newton."""
CROSSED_NM: Final = 3.0
"""The step of a load where a gap is crossed earlier or later than believed."""
STEP: Final = 0.75**0.5 / 2
"""A step of a load in the middle of an even spread of forces changes the slope by so much of the step over
the standard deviation of the forces."""
LEAST_CYCLES: Final = 2
"""With more a straight line can be told."""
SUREST: Final = 0.05
BELIEVABLE: Final = (0.5, 2.0)


@dataclass(frozen=True, slots=True, eq=False)
class PressFit:
    """What the currents have told on a leg of a press, and how many legs may follow.

    Sums over the cycles in which a joint says something, (5,) each, for a straight line over the force.
    """

    legs: int = 2
    n: Array = field(default_factory=lambda: np.zeros(5))
    sums: Array = field(default_factory=lambda: np.zeros((2, 3, 5)))
    """Of the model's force [N], of what it would load a joint with, and of what the currents tell [N m]; and
    of each times the force."""

    def after(self, model_N: float, model_Nm: Array, push_Nm: Array, says: Flags) -> "PressFit":
        """One cycle more."""
        terms = np.stack((np.full_like(push_Nm, model_N), model_Nm, push_Nm)) * says
        return PressFit(self.legs, self.n + says, self.sums + np.stack((terms, model_N * terms)))


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
    pressing: Pressing,
    rate_N_s: float,
    hold: Setpoint,
    joints: JointEstimate,
    load: LoadEstimate,
    sensors: Sensors,
) -> PressFit:
    """The fit with this cycle's currents, if the force rises briskly."""
    if rate_N_s <= BRISK_SHARE * config.params.preload.rate_N_s:
        return fit
    friction = joints.reference.friction_Nm
    resisting = np.where(np.isfinite(friction), friction, 0.0) * np.sign(hold.rate_rad_s)
    carried = resisting - config.torque_constant_Nm_A * sensors.current_A
    push = carried - (load.torque_Nm - load.press_torque_Nm)
    # in its gap a gear passes nothing on
    half, bounds = joints.reference.half_gap_rad, joints.bounds
    lowest_rad, highest_rad = bounds.lowest_rad[:, LIKELY], bounds.highest_rad[:, LIKELY]
    held = held_on_flank(half, lowest_rad, highest_rad, np.zeros_like(push))
    # its encoder counts: the friction of a motor that has yet to break away is not what it is in motion
    follows = joints.motor_rate_rad_s * hold.rate_rad_s > 0.5 * hold.rate_rad_s**2
    says = held & follows
    return fit.after(pressing.model_N, load.press_torque_Nm / pressing.share, push, says)


def felt_share(config: Config, fit: PressFit, joints: JointEstimate, pressing: Pressing) -> FeltShare | None:
    """What the rock gives back for a newton of the model; None if that cannot be.

    The likeliest of what was likely beforehand and of what the joints that moved tell, by its noise.
    """
    says = fit.n > LEAST_CYCLES
    if not says.any():
        return None
    n, (mean, mixed) = fit.n[says], fit.sums[:, :, says] / fit.n[says]
    spread_N2, model_Nm, push_Nm = mixed - mean * mean[0]
    # a straight line's slope, and what noise and a step of the load in its middle make of it
    model_Nm_N, push_Nm_N = model_Nm / spread_N2, push_Nm / spread_N2
    reading_Nm = READING_A * config.torque_constant_Nm_A[says] / np.sqrt(n)
    noise_Nm_N = np.hypot(reading_Nm, STEP * CROSSED_NM) / np.sqrt(spread_N2)
    levers = np.column_stack((model_Nm_N, _levers_across(config, joints, pressing)[says]))
    levers /= noise_Nm_N[:, None]
    likely = np.array([pressing.share, 0.0, 0.0, 0.0])
    spread = np.array([pressing.share_unsure, ACROSS, ACROSS, TWIST_M])
    information = np.diag(spread**-2) + levers.T @ levers
    surprise = levers.T @ (push_Nm_N / noise_Nm_N - levers @ likely)
    along, *across, _ = likely + np.linalg.solve(information, surprise)
    unsure = max(float(np.sqrt(np.linalg.inv(information)[0, 0])), SUREST)
    believable = BELIEVABLE[0] < along < BELIEVABLE[1]
    return FeltShare(float(along), float(np.hypot(*across)), unsure) if believable else None


def _levers_across(config: Config, joints: JointEstimate, pressing: Pressing) -> Array:
    """Loads (5, 3) by a newton along the tool's y axis, by one along z, and by a newton metre about x."""
    frames = settle_output(config.arm, joints.output_rad, joints.gravity_R_m_s2, pressing.pushed).frames
    X_RT = tool_pose(config.arm, frames, pressing.tool)
    J = joint_jacobian(frames, X_RT.p)
    return np.column_stack((J[3:].T @ X_RT.R[:, 1:], J[:3].T @ X_RT.R[:, 0]))


def corrected(press: Press, felt: FeltShare) -> Pressing:
    """What is pressed with at the end of a press, by what was felt on the way."""
    force_N = press.start.force_N + felt.along * press.change_N
    done = replace(press.start, model_N=press.end_model_N)
    return replace(done, share=force_N / press.end_model_N, share_unsure=felt.unsure)
