"""What the motors' currents tell of a press, and the change of force that follows from it.

Between the first and the last newtons of the overdrive the load of every joint rises by what the rock gives
back; friction, weight and bias are the same at both ends and drop out. Five loads against a force of three
components and a torque about the tool's axis. An arm of five joints cannot keep a tool from turning about
that axis, so the pads slip and their friction twists the tool.
"""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.estimate.gear import held_on_side
from fsw.estimate.joints import JointEstimate
from fsw.estimate.load import LoadEstimate
from fsw.kinematics.chain import joint_jacobian, tool_pose
from fsw.kinematics.statics import rest
from fsw.kinematics.transforms import Array
from fsw.messages import Flags, Sensors
from fsw.motion.paths import Setpoint
from fsw.motion.plan_press import Press, Pressing

END_SHARE: Final = 0.25
"""Of the change of force, at either end, over which is averaged."""
BRISK_SHARE: Final = 0.75
"""Of its highest rate that the force must rise with: slower, friction is not what it is in motion."""
MOVING_RAD_S: Final = 5e-5
"""Slower, a joint says nothing: its friction is not what it is in motion."""
READING_A: Final = 0.02
"""Noise of one reading of a current."""
ACROSS: Final = 0.3
"""Of a newton of the model, so much may well be felt across."""
TWIST_M: Final = 0.0225
"""Torque about the axis that pads 45 mm off it, with a friction coefficient of 0.5, pass on for a newton."""
SUREST: Final = 0.05
BELIEVABLE: Final = (0.5, 2.0)


@dataclass(frozen=True, slots=True, eq=False)
class PressEnd:
    """Sums at one end of a press over the cycles in which a joint says something, (5,) each."""

    n: Array = field(default_factory=lambda: np.zeros(5))
    sums: Array = field(default_factory=lambda: np.zeros((3, 5)))
    """Of the model's force [N], of what it would load a joint with, and of what the currents tell [N m]."""

    def after(self, model_N: float, model_Nm: Array, push_Nm: Array, says: Flags) -> "PressEnd":
        """One cycle more."""
        terms = np.stack((np.full_like(push_Nm, model_N), model_Nm, push_Nm))
        return PressEnd(self.n + says, self.sums + terms * says)


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
    load: LoadEstimate,
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
    push = carried - (load.torque_Nm - load.of_push_Nm)
    # in its gap a gear passes nothing on
    held = held_on_side(joints.reference.half_gap_rad, joints.bounds, np.zeros_like(push))
    says = held & (np.abs(hold.rate_rad_s) > MOVING_RAD_S)
    cycle = (pressing.model_N, load.of_push_Nm / pressing.share, push, says)
    if gone <= END_SHARE:
        return replace(fit, first=fit.first.after(*cycle))
    return replace(fit, last=fit.last.after(*cycle))


def felt_share(config: Config, fit: PressFit, joints: JointEstimate, pressing: Pressing) -> FeltShare | None:
    """What the rock gives back for a newton of the model; None if that cannot be.

    The likeliest of what was likely beforehand and of what the joints that moved tell, by its noise.
    """
    says = (fit.first.n > 0) & (fit.last.n > 0)
    if not says.any():
        return None
    first_n, last_n = fit.first.n[says], fit.last.n[says]
    rise_N, model_Nm, push_Nm = fit.last.sums[:, says] / last_n - fit.first.sums[:, says] / first_n
    noise_Nm = READING_A * config.torque_constant_Nm_A[says] * np.sqrt(1 / first_n + 1 / last_n)
    others = rise_N[:, None] * _levers_across(config, joints, pressing)[says]
    levers = np.column_stack((model_Nm, others)) / noise_Nm[:, None]
    likely = np.array([pressing.share, 0.0, 0.0, 0.0])
    spread = np.array([pressing.share_unsure, ACROSS, ACROSS, TWIST_M])
    information = np.diag(spread**-2) + levers.T @ levers
    surprise = levers.T @ (push_Nm / noise_Nm - levers @ likely)
    along, *across, _ = likely + np.linalg.solve(information, surprise)
    unsure = max(float(np.sqrt(np.linalg.inv(information)[0, 0])), SUREST)
    believable = BELIEVABLE[0] < along < BELIEVABLE[1]
    return FeltShare(float(along), float(np.hypot(*across)), unsure) if believable else None


def _levers_across(config: Config, joints: JointEstimate, pressing: Pressing) -> Array:
    """Loads (5, 3) by a newton along the tool's y axis, by one along z, and by a newton metre about x."""
    frames = rest(config.arm, joints.output_rad, joints.gravity_R_m_s2, pressing.pushed).frames
    X_RT = tool_pose(config.arm, frames, pressing.tool)
    J = joint_jacobian(frames, X_RT.p)
    return np.column_stack((J[3:].T @ X_RT.R[:, 1:], J[:3].T @ X_RT.R[:, 0]))


def corrected(press: Press, felt: FeltShare) -> Pressing:
    """What is pressed with at the end of a press, by what was felt on the way."""
    force_N = press.start.force_N + felt.along * press.change_N
    done = replace(press.start, model_N=press.end_model_N)
    return replace(done, share=force_N / press.end_model_N, share_unsure=felt.unsure)
