"""Preload without a force sensor: overdrive through the modelled stiffness, corrected by motor currents.

While the overdrive grows, the load of every joint rises by what the rock gives back; friction, weight and
bias stay what they are and drop out. Five loads against a force of three components and a torque about the
tool's axis: an arm of five joints cannot keep a tool from turning about that axis, so the pads slide, and
their friction resists.
"""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.enums import Tool
from fsw.estimate.gear import LIKELY
from fsw.estimate.joints import JointEstimate, LoadEstimate
from fsw.kinematics.chain import joint_jacobian, tool_pose
from fsw.kinematics.statics import ToolForce, held_on_flank, settle_output
from fsw.kinematics.task import ROOT_TOLERANCE, task_error, task_jacobian
from fsw.kinematics.transforms import Array
from fsw.messages import Flags, Sensors
from fsw.motion.compensation import Compensation
from fsw.motion.path_check import check_paths
from fsw.motion.paths import Setpoint, Travel
from fsw.motion.plan import (
    TOO_SOFT,
    JointPositions,
    Plan,
    Refusal,
    describe_worst_limit,
    plan_over_knots,
    worst_limit_excess,
)

MAX_NEWTON_STEPS: Final = 20
ROUNDING_N: Final = 1e-6
RAMP_S: Final = 1.0
"""In which the rate of the force builds up."""
PRIOR_RATIO_STD: Final = 0.25
"""By how much a built arm's stiffness may well differ from the model's."""
ESTIMATED_RATIO_STD: Final = 0.1
"""So well is it known once it was felt."""
RATIO_SIGMAS: Final = 1.5
"""Times that the stiffness may well be off."""
FRICTION_FACTOR: Final = 1.5
"""Friction may have risen by so much since it was felt at the hardstop."""


@dataclass(frozen=True, slots=True, eq=False)
class PreloadState:
    """A tool that presses: where it touched, how it looked there, and how far the arm is overdriven since.

    The overdrive is counted in newtons of the model: with so many the modelled arm would press. The built arm
    is stiffer or softer, and presses with a share of them.
    """

    tool: Tool
    p_RoTo_R_m: Array
    axis_R: Array
    model_N: float
    resolver_offset_rad: Array
    """How far the resolvers were from the believed outputs when it touched, (5,)."""
    force_ratio: float = 1.0
    """True over modelled force, as far as it was felt."""
    force_ratio_std: float = PRIOR_RATIO_STD
    """Standard deviation of what is to be felt next."""

    @property
    def force_N(self) -> float:
        """With what it is believed to press."""
        return self.force_ratio * self.model_N

    def reaction_at(self, force_N: Array | float) -> ToolForce:
        """What comes back of a force or forces (...)."""
        column = self.axis_R.reshape(3, *(1,) * np.ndim(force_N))
        return ToolForce(self.tool, -column * force_N)

    @property
    def reaction(self) -> ToolForce:
        """What comes back of the force as it is believed to be."""
        return self.reaction_at(self.force_N)


@dataclass(frozen=True, slots=True, eq=False)
class PreloadChange:
    """A change of force under way, to its end or to where it is to be felt first."""

    start: PreloadState
    end_model_N: float
    target_N: float
    torque_per_N: Array
    """By how much each joint's load rises with the force, (5,)."""
    free_Nm: Array
    """What the joints carry without it, (5,)."""
    end: JointPositions
    """Of the motors and gears."""

    @property
    def change_N(self) -> float:
        """Of the model's force."""
        return self.end_model_N - self.start.model_N

    def state_after(self, travelled_N: float) -> PreloadState:
        """What is pressed with when so much of the change is done."""
        if travelled_N >= abs(self.change_N) - ROUNDING_N:
            return replace(self.start, model_N=self.end_model_N)
        return replace(self.start, model_N=self.start.model_N + float(np.sign(self.change_N)) * travelled_N)


def holding_force_N(config: Config) -> float:
    """With what a touch ends, so that the tool stays in contact: one step more than closes its switch."""
    return config.params.motion.switch_force_N + config.params.preload.step_N


def model_contact(config: Config, joints: JointEstimate, tool: Tool) -> PreloadState:
    """A tool that touches with what closes its switch: so little pushes it that friction does not count."""
    arm, gravity, force_N = config.arm, joints.gravity_R_m_s2, config.params.motion.switch_force_N
    free = tool_pose(arm, settle_output(arm, joints.output_rad, gravity).frames, tool)
    push = ToolForce(tool, -free.R[:, 0] * force_N)
    pushed = tool_pose(arm, settle_output(arm, joints.output_rad, gravity, push).frames, tool)
    return PreloadState(tool, pushed.p, pushed.R[:, 0], force_N, joints.resolver_error_rad)


def plan_preload(
    config: Config, joints: JointEstimate, preload: PreloadState, force_N: float
) -> tuple[Plan, PreloadChange] | Refusal:
    """The overdrive from one force to another, such that the tool stays where it touches and looks as it did.

    What the arm gives way, sideways and in its angle too, is made up for at every force on the way, so
    nothing is left for friction to hold.
    """
    params = config.params.preload
    end_N = _first_force_N(preload, force_N) / preload.force_ratio
    change_N = abs(end_N - preload.model_N)
    forces = np.linspace(preload.model_N, end_N, int(np.ceil(change_N / params.step_N)) + 1)
    output = _solve_outputs(config, joints, preload, forces)
    if output is None:
        return Refusal(f"no overdrive found from {preload.force_N:.1f} to {force_N:.1f} N")
    over = worst_limit_excess(config, output)
    if np.any(over > 0):
        k = int(np.argmax(over > 0))
        return Refusal(
            f"at {preload.force_ratio * forces[k]:.1f} N, {describe_worst_limit(config, output[:, k])}"
        )
    pushed = settle_output(config.arm, output, joints.gravity_R_m_s2, preload.reaction_at(forces))
    carried = settle_output(
        config.arm, output, joints.gravity_R_m_s2, preload.reaction_at(preload.force_ratio * forces)
    )
    if not (np.all(pushed.converged) and np.all(carried.converged)):
        return Refusal(TOO_SOFT)
    load_Nm, carried_Nm = pushed.torque_Nm, carried.torque_Nm
    travel = Travel(change_N, params.rate_N_s, params.rate_N_s / RAMP_S, 2 * params.rate_N_s / RAMP_S**2)
    # gaps are crossed under the believed force; what the model winds gears up beyond that is overdrive
    overdriven = output - (load_Nm - carried_Nm) / config.arm.gear_stiffness_Nm_rad[:, None]
    plan = plan_over_knots(config, joints, overdriven, carried_Nm, Compensation(), travel)
    meeting = check_paths(config, joints, plan.paths, config.params.collision.padding_m, preload.tool)
    if meeting is not None:
        return Refusal(meeting)
    per_N = (load_Nm[:, -1] - load_Nm[:, 0]) / (end_N - preload.model_N)
    free_Nm = load_Nm[:, 0] - per_N * preload.model_N
    return plan, PreloadChange(preload, end_N, force_N, per_N, free_Nm, plan.end)


def _first_force_N(preload: PreloadState, force_N: float) -> float:
    """The force to go to: all of it, or, while little is known of the stiffness, what cannot be too much."""
    if preload.force_ratio_std <= ESTIMATED_RATIO_STD or force_N <= preload.force_N:
        return force_N
    return preload.force_N + (force_N - preload.force_N) / (1 + RATIO_SIGMAS * preload.force_ratio_std)


def preload_limit_A(config: Config, joints: JointEstimate, press: PreloadChange) -> Array:
    """Current limits (5) that stall the motors before the force is much larger than it ought to be."""
    most_N = max(press.start.force_N, press.target_N) * (1 + config.params.preload.guard_share)
    carried = np.abs(press.free_Nm) + np.abs(press.torque_per_N) * most_N
    torque = carried + FRICTION_FACTOR * joints.reference.friction_Nm
    limit: Array = np.minimum(torque / config.torque_constant_Nm_A, config.current_limit_A)
    return limit


def _solve_outputs(
    config: Config, joints: JointEstimate, preload: PreloadState, forces: Array
) -> Array | None:
    """Outputs (5, k) at which the pushed arm keeps the tool where it touches; None if there are none."""
    arm, push, tool = config.arm, preload.reaction_at(forces), preload.tool
    p, axis = preload.p_RoTo_R_m[:, None], preload.axis_R[:, None]
    output = np.tile(joints.output_rad[:, None], forces.size)
    for _ in range(MAX_NEWTON_STEPS):
        hanging = settle_output(arm, output, joints.gravity_R_m_s2, push)
        X_RT = tool_pose(arm, hanging.frames, tool)
        error = task_error(X_RT, p, axis)
        if np.abs(error).max() < ROOT_TOLERANCE:
            return output
        J = np.moveaxis(task_jacobian(hanging.frames, X_RT, axis), -1, 0)
        # the pseudo-inverse has an answer at a singularity too
        output = output - (np.linalg.pinv(J) @ np.moveaxis(error, -1, 0)[..., None])[..., 0].T
    return None


MIN_RATE_SHARE: Final = 0.75
"""Of its highest rate that the force must rise with: slower, friction is not what it is in motion."""
CURRENT_NOISE_A: Final = 0.02
"""Noise of one reading of a current."""
TRANSVERSE_STD: Final = 0.3
"""Of a newton of the model, so much may well be felt across."""
TWIST_STD_M: Final = 0.0225
"""Torque about the axis that pads 45 mm off it, with a friction coefficient of 0.5, pass on for a newton."""
BACKLASH_STEP_NM: Final = 3.0
"""The step of a load where a gap is crossed earlier or later than believed."""
STEP_SLOPE_FACTOR: Final = 0.75**0.5 / 2
"""A step of a load in the middle of an even spread of forces changes the slope by so much of the step over
the standard deviation of the forces."""
MIN_CYCLES: Final = 2
"""With more a straight line can be told."""
MIN_RATIO_STD: Final = 0.05
RATIO_RANGE: Final = (0.5, 2.0)


@dataclass(frozen=True, slots=True, eq=False)
class ForceFit:
    """What the currents have told on a leg of a press, and how many legs may follow.

    Sums over the cycles in which a joint says something, (5,) each, for a straight line over the force.
    """

    legs_left: int = 2
    n: Array = field(default_factory=lambda: np.zeros(5))
    sums: Array = field(default_factory=lambda: np.zeros((2, 3, 5)))
    """Of the model's force [N], of what it would load a joint with, and of what the currents tell [N m]; and
    of each times the force."""

    def add_cycle(self, model_N: float, model_Nm: Array, push_Nm: Array, says: Flags) -> "ForceFit":
        """One cycle more."""
        terms = np.stack((np.full_like(push_Nm, model_N), model_Nm, push_Nm)) * says
        return ForceFit(self.legs_left, self.n + says, self.sums + np.stack((terms, model_N * terms)))


@dataclass(frozen=True, slots=True)
class ForceRatio:
    """What is felt for a newton of the model."""

    along: float
    across: float
    std: float
    """Standard deviation of the first."""


def update_force_fit(
    config: Config,
    fit: ForceFit,
    preload: PreloadState,
    rate_N_s: float,
    setpoint: Setpoint,
    joints: JointEstimate,
    load: LoadEstimate,
    sensors: Sensors,
) -> ForceFit:
    """The fit with this cycle's currents, if the force rises briskly."""
    if rate_N_s <= MIN_RATE_SHARE * config.params.preload.rate_N_s:
        return fit
    friction = joints.reference.friction_Nm
    resisting = np.where(np.isfinite(friction), friction, 0.0) * np.sign(setpoint.rate_rad_s)
    carried = resisting - config.torque_constant_Nm_A * sensors.current_A
    push = carried - (load.torque_Nm - load.press_torque_Nm)
    # in its gap a gear passes nothing on
    half, bounds = joints.reference.half_gap_rad, joints.bounds
    lowest_rad, highest_rad = bounds.lowest_rad[:, LIKELY], bounds.highest_rad[:, LIKELY]
    held = held_on_flank(half, lowest_rad, highest_rad, np.zeros_like(push))
    # its encoder counts: the friction of a motor that has yet to break away is not what it is in motion
    follows = joints.motor_rate_rad_s * setpoint.rate_rad_s > 0.5 * setpoint.rate_rad_s**2
    says = held & follows
    return fit.add_cycle(preload.model_N, load.press_torque_Nm / preload.force_ratio, push, says)


def estimate_force_ratio(
    config: Config, fit: ForceFit, joints: JointEstimate, preload: PreloadState
) -> ForceRatio | None:
    """What the rock gives back for a newton of the model; None if that cannot be.

    The likeliest of what was likely beforehand and of what the joints that moved tell, by its noise.
    """
    says = fit.n > MIN_CYCLES
    if not says.any():
        return None
    n, (mean, mixed) = fit.n[says], fit.sums[:, :, says] / fit.n[says]
    spread_N2, model_Nm, push_Nm = mixed - mean * mean[0]
    # a straight line's slope, and what noise and a step of the load in its middle make of it
    model_Nm_N, push_Nm_N = model_Nm / spread_N2, push_Nm / spread_N2
    reading_Nm = CURRENT_NOISE_A * config.torque_constant_Nm_A[says] / np.sqrt(n)
    noise_Nm_N = np.hypot(reading_Nm, STEP_SLOPE_FACTOR * BACKLASH_STEP_NM) / np.sqrt(spread_N2)
    levers = np.column_stack((model_Nm_N, _transverse_jacobian(config, joints, preload)[says]))
    levers /= noise_Nm_N[:, None]
    likely = np.array([preload.force_ratio, 0.0, 0.0, 0.0])
    spread = np.array([preload.force_ratio_std, TRANSVERSE_STD, TRANSVERSE_STD, TWIST_STD_M])
    information = np.diag(spread**-2) + levers.T @ levers
    weighted_residual = levers.T @ (push_Nm_N / noise_Nm_N - levers @ likely)
    along, *across, _ = likely + np.linalg.solve(information, weighted_residual)
    unsure = max(float(np.sqrt(np.linalg.inv(information)[0, 0])), MIN_RATIO_STD)
    believable = RATIO_RANGE[0] < along < RATIO_RANGE[1]
    return ForceRatio(float(along), float(np.hypot(*across)), unsure) if believable else None


def _transverse_jacobian(config: Config, joints: JointEstimate, preload: PreloadState) -> Array:
    """Loads (5, 3) by a newton along the tool's y axis, by one along z, and by a newton metre about x."""
    frames = settle_output(config.arm, joints.output_rad, joints.gravity_R_m_s2, preload.reaction).frames
    X_RT = tool_pose(config.arm, frames, preload.tool)
    J = joint_jacobian(frames, X_RT.p)
    return np.column_stack((J[3:].T @ X_RT.R[:, 1:], J[:3].T @ X_RT.R[:, 0]))


def correct_preload(press: PreloadChange, felt: ForceRatio) -> PreloadState:
    """What is pressed with at the end of a press, by what was felt on the way."""
    force_N = press.start.force_N + felt.along * press.change_N
    done = replace(press.start, model_N=press.end_model_N)
    return replace(done, force_ratio=force_N / press.end_model_N, force_ratio_std=felt.std)
