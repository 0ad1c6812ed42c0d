"""Preload without a force sensor: overdrive through the modelled stiffness, corrected by motor currents.

The plan of a change of force comes first, then the fit of the currents that corrects it.

While the overdrive rises, the reaction of the surface adds to the load of every joint; friction, weight and
bias are constant and drop out. Five loads determine three components of force and a torque about the tool
axis. An arm of five joints cannot prevent rotation about that axis: the pads slide, and friction resists.
"""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from fsw.config import Config
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
"""Time in which the rate of the force rises to its bound."""
PRIOR_RATIO_STD: Final = 0.25
"""Prior standard deviation of the force ratio: a built arm differs from the model in stiffness."""
ESTIMATED_RATIO_STD: Final = 0.1
"""Standard deviation of the force ratio below which it counts as known."""
RATIO_SIGMAS: Final = 1.5
"""Standard deviations by which an unknown force ratio may exceed its estimate."""
FRICTION_FACTOR: Final = 1.5
"""Factor by which friction may have risen since it was measured at the hardstop."""
MIN_RATE_SHARE: Final = 0.75
"""Share of its highest rate at which the force must rise to be fitted; slower, friction differs."""
CURRENT_NOISE_A: Final = 0.02
"""Standard deviation of one reading of a current."""
TRANSVERSE_STD: Final = 0.3
"""Prior standard deviation of each transverse force, in newtons per newton of the model."""
TWIST_STD_M: Final = 0.0225
"""Prior standard deviation of the torque about the tool axis, per newton of the model.

Pads 45 mm from the axis with a friction coefficient of 0.5 transmit this torque.
"""
BACKLASH_STEP_NM: Final = 3.0
"""Step of a load if an output crosses its backlash earlier or later than predicted."""
STEP_SLOPE_FACTOR: Final = 0.75**0.5 / 2
"""Change of the slope of a load by a step in the middle of evenly spread forces.

Its unit is the step over the standard deviation of the forces.
"""
MIN_CYCLES: Final = 2
"""A straight line is fitted to more cycles than this."""
MIN_RATIO_STD: Final = 0.05
"""Least standard deviation of an estimated force ratio."""
RATIO_RANGE: Final = (0.5, 2.0)
"""Plausible force ratios; any other is rejected."""


@dataclass(frozen=True, slots=True, eq=False)
class PreloadState:
    """Tool in contact: its pose at the contact, and the overdrive since.

    The unit of overdrive is the newton of the model: the force that the modelled arm would apply. The built
    arm is stiffer or softer and applies `force_ratio` times as much.
    """

    tool: str
    p_RoTo_R_m: Array
    """Position of the tool at the contact, (3,)."""
    axis_R: Array
    """Unit direction of the tool axis at the contact, (3,)."""
    model_N: float
    """Overdrive in newtons of the model."""
    resolver_offset_rad: Array
    """Resolvers less estimated outputs at the contact, (5,)."""
    force_ratio: float = 1.0
    """Estimate of true over modelled force."""
    force_ratio_std: float = PRIOR_RATIO_STD
    """Standard deviation of the ratio for the next change of force."""

    @property
    def force_N(self) -> float:
        """Return the estimated force in newtons."""
        return self.force_ratio * self.model_N

    def reaction_at(self, force_N: Array | float) -> ToolForce:
        """Return the reaction to a force.

        Args:
            force_N: Force of the tool on the surface, scalar or shape (...).

        Returns:
            Force on the tool in RMECH, batch (...).
        """
        column = self.axis_R.reshape(3, *(1,) * np.ndim(force_N))
        return ToolForce(self.tool, -column * force_N)

    @property
    def reaction(self) -> ToolForce:
        """Return the reaction to the estimated force."""
        return self.reaction_at(self.force_N)


@dataclass(frozen=True, slots=True, eq=False)
class PreloadChange:
    """One leg of a change of force; a leg may end short of the target."""

    start: PreloadState
    end_model_N: float
    """Overdrive at the end of this leg, in newtons of the model."""
    target_N: float
    """Commanded force."""
    torque_per_N: Array
    """Load of each joint in newton metres per newton of the model, (5,)."""
    free_Nm: Array
    """Loads without the force, (5,)."""
    end: JointPositions
    """Motor and gear angles at the end of this leg."""

    @property
    def change_N(self) -> float:
        """Return the change of overdrive in newtons of the model."""
        return self.end_model_N - self.start.model_N

    def state_after(self, travelled_N: float) -> PreloadState:
        """Return the preload after a part of the change, in newtons of the model."""
        if travelled_N >= abs(self.change_N) - ROUNDING_N:
            return replace(self.start, model_N=self.end_model_N)
        return replace(self.start, model_N=self.start.model_N + float(np.sign(self.change_N)) * travelled_N)


def holding_force_N(config: Config) -> float:
    """Compute the force that keeps a tool in contact: one step more than the force that closes its switch."""
    return config.params.motion.switch_force_N + config.params.preload.step_N


def model_contact(config: Config, joints: JointEstimate, tool: str) -> PreloadState:
    """Model the preload of a tool that has just touched with the force that closes its switch.

    Friction is neglected at so small a force.
    """
    arm, gravity, force_N = config.arm, joints.gravity_R_m_s2, config.params.motion.switch_force_N
    free = tool_pose(arm, settle_output(arm, joints.output_rad, gravity).frames, tool)
    push = ToolForce(tool, -free.R[:, 0] * force_N)
    pushed = tool_pose(arm, settle_output(arm, joints.output_rad, gravity, push).frames, tool)
    return PreloadState(tool, pushed.p, pushed.R[:, 0], force_N, joints.resolver_error_rad)


def plan_preload(
    config: Config, joints: JointEstimate, preload: PreloadState, force_N: float
) -> tuple[Plan, PreloadChange] | Refusal:
    """Plan the overdrive from one force to another at a constant pose of the tool.

    Each knot compensates the deflection of the arm in position and direction, so the tool does not need
    friction to stay in place.

    Args:
        config: Configuration of flight software.
        joints: Estimate of the joints, from which the change starts.
        preload: Preload at the start.
        force_N: Commanded force.

    Returns:
        The plan and its change of force, or the reason for a refusal. While the stiffness of the arm is not
        known, both end short of the commanded force.
    """
    params = config.params.preload
    end_N = _first_force_N(preload, force_N) / preload.force_ratio
    change_N = abs(end_N - preload.model_N)
    forces = np.linspace(preload.model_N, end_N, int(np.ceil(change_N / params.step_N)) + 1)
    output = _solve_outputs(config, joints, preload, forces)
    if output is None:
        return Refusal(f"no overdrive found from {preload.force_N:.1f} to {force_N:.1f} N")
    excess = worst_limit_excess(config, output)
    if np.any(excess > 0):
        k = int(np.argmax(excess > 0))
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
    # outputs cross their backlash under the estimated force; wind-up beyond that is overdrive
    overdriven = output - (load_Nm - carried_Nm) / config.arm.gear_stiffness_Nm_rad[:, None]
    plan = plan_over_knots(config, joints, overdriven, carried_Nm, Compensation(), travel)
    collision = check_paths(config, joints, plan.paths, config.params.collision.padding_m, preload.tool)
    if collision is not None:
        return Refusal(collision)
    per_N = (load_Nm[:, -1] - load_Nm[:, 0]) / (end_N - preload.model_N)
    free_Nm = load_Nm[:, 0] - per_N * preload.model_N
    return plan, PreloadChange(preload, end_N, force_N, per_N, free_Nm, plan.end)


def _first_force_N(preload: PreloadState, force_N: float) -> float:
    """Return the force of the first leg: less than commanded while the force ratio is not known."""
    if preload.force_ratio_std <= ESTIMATED_RATIO_STD or force_N <= preload.force_N:
        return force_N
    return preload.force_N + (force_N - preload.force_N) / (1 + RATIO_SIGMAS * preload.force_ratio_std)


def preload_limit_A(config: Config, joints: JointEstimate, change: PreloadChange) -> Array:
    """Compute current limits that stall the motors before the force much exceeds the commanded one.

    Args:
        config: Configuration of flight software.
        joints: Estimate of the joints, of which the measured friction is used.
        change: Change of force.

    Returns:
        Current limits in amperes, shape (5,).
    """
    max_force_N = max(change.start.force_N, change.target_N) * (
        1 + config.params.preload.current_margin_share
    )
    carried_Nm = np.abs(change.free_Nm) + np.abs(change.torque_per_N) * max_force_N
    torque = carried_Nm + FRICTION_FACTOR * joints.reference.friction_Nm
    limit: Array = np.minimum(torque / config.torque_constant_Nm_A, config.current_limit_A)
    return limit


def _solve_outputs(
    config: Config, joints: JointEstimate, preload: PreloadState, forces: Array
) -> Array | None:
    """Find outputs (5, k) that keep the tool at its contact pose under forces (k,), or None."""
    arm, push, tool = config.arm, preload.reaction_at(forces), preload.tool
    p, axis = preload.p_RoTo_R_m[:, None], preload.axis_R[:, None]
    output = np.tile(joints.output_rad[:, None], forces.size)
    for _ in range(MAX_NEWTON_STEPS):
        equilibrium = settle_output(arm, output, joints.gravity_R_m_s2, push)
        X_RT = tool_pose(arm, equilibrium.frames, tool)
        error = task_error(X_RT, p, axis)
        if np.abs(error).max() < ROOT_TOLERANCE:
            return output
        J = np.moveaxis(task_jacobian(equilibrium.frames, X_RT, axis), -1, 0)
        # the pseudo-inverse exists at a singularity too
        output = output - (np.linalg.pinv(J) @ np.moveaxis(error, -1, 0)[..., None])[..., 0].T
    return None


@dataclass(frozen=True, slots=True, eq=False)
class ForceFit:
    """Sums over cycles, for a straight line of each joint's load over the force.

    A joint counts in the cycles in which its current shows the load.
    """

    legs_left: int = 2
    """Number of corrections that may follow."""
    n: Array = field(default_factory=lambda: np.zeros(5))
    sums: Array = field(default_factory=lambda: np.zeros((2, 3, 5)))
    """Sums of the model's force [N], of its modelled load and of the measured load [N m], (3, 5).

    The first row has the sums, the second those of each times the force.
    """

    def add_cycle(self, model_N: float, model_Nm: Array, push_Nm: Array, counts: Flags) -> "ForceFit":
        """Add one cycle.

        Args:
            model_N: Force of the model.
            model_Nm: Loads by that force in the model, shape (5,).
            push_Nm: Loads by the force as measured by the currents, shape (5,).
            counts: Joints whose currents show the load, shape (5,).

        Returns:
            The fit with this cycle.
        """
        terms = np.stack((np.full_like(push_Nm, model_N), model_Nm, push_Nm)) * counts
        return ForceFit(self.legs_left, self.n + counts, self.sums + np.stack((terms, model_N * terms)))


@dataclass(frozen=True, slots=True)
class ForceRatio:
    """Estimated force in newtons per newton of the model."""

    along: float
    """Component along the tool axis."""
    across: float
    """Component across the tool axis."""
    std: float
    """Standard deviation of the component along the axis."""


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
    """Add the currents of this cycle to the fit if the force rises fast enough.

    The measured load is the motor torque less friction, and less the load without the force.

    Args:
        config: Configuration of flight software.
        fit: Fit of the cycles before.
        preload: Preload of this cycle.
        rate_N_s: Rate of the overdrive.
        setpoint: Set-point of this cycle.
        joints: Estimate of the joints.
        load: Estimate of the loads.
        sensors: Readings of this cycle.

    Returns:
        The fit with this cycle.
    """
    if rate_N_s <= MIN_RATE_SHARE * config.params.preload.rate_N_s:
        return fit
    friction = joints.reference.friction_Nm
    resisting = np.where(np.isfinite(friction), friction, 0.0) * np.sign(setpoint.rate_rad_s)
    carried = resisting - config.torque_constant_Nm_A * sensors.current_A
    push = carried - (load.torque_Nm - load.press_torque_Nm)
    # a gear inside its backlash transmits no torque
    half, bounds = joints.reference.half_backlash_rad, joints.bounds
    lowest_rad, highest_rad = bounds.lowest_rad[:, LIKELY], bounds.highest_rad[:, LIKELY]
    held = held_on_flank(half, lowest_rad, highest_rad, np.zeros_like(push))
    # only a motor that turns counts: static friction differs from friction in motion
    follows = joints.motor_rate_rad_s * setpoint.rate_rad_s > 0.5 * setpoint.rate_rad_s**2
    model_Nm = load.press_torque_Nm / preload.force_ratio
    return fit.add_cycle(preload.model_N, model_Nm, push, held & follows)


def estimate_force_ratio(
    config: Config, fit: ForceFit, joints: JointEstimate, preload: PreloadState
) -> ForceRatio | None:
    """Estimate the force per newton of the model by the maximum of the posterior density.

    The unknowns are the force along the tool axis, two forces across it and the torque about it. Each has a
    Gaussian prior; the measurements are the slopes of the measured loads over the force.

    Args:
        config: Configuration of flight software.
        fit: Fit of a leg.
        joints: Estimate of the joints.
        preload: Preload at the end of the leg.

    Returns:
        The ratio; None without measurements or if the ratio is implausible.
    """
    counts = fit.n > MIN_CYCLES
    if not counts.any():
        return None
    n, (mean, mixed) = fit.n[counts], fit.sums[:, :, counts] / fit.n[counts]
    spread_N2, model_Nm, push_Nm = mixed - mean * mean[0]
    # the slope of a straight line, and its error by noise and by a step of the load in its middle
    model_Nm_N, push_Nm_N = model_Nm / spread_N2, push_Nm / spread_N2
    reading_Nm = CURRENT_NOISE_A * config.torque_constant_Nm_A[counts] / np.sqrt(n)
    noise_Nm_N = np.hypot(reading_Nm, STEP_SLOPE_FACTOR * BACKLASH_STEP_NM) / np.sqrt(spread_N2)
    levers = np.column_stack((model_Nm_N, _transverse_jacobian(config, joints, preload)[counts]))
    levers /= noise_Nm_N[:, None]
    prior = np.array([preload.force_ratio, 0.0, 0.0, 0.0])
    prior_std = np.array([preload.force_ratio_std, TRANSVERSE_STD, TRANSVERSE_STD, TWIST_STD_M])
    information = np.diag(prior_std**-2) + levers.T @ levers
    weighted_residual = levers.T @ (push_Nm_N / noise_Nm_N - levers @ prior)
    along, *across, _ = prior + np.linalg.solve(information, weighted_residual)
    std = max(float(np.sqrt(np.linalg.inv(information)[0, 0])), MIN_RATIO_STD)
    plausible = RATIO_RANGE[0] < along < RATIO_RANGE[1]
    return ForceRatio(float(along), float(np.hypot(*across)), std) if plausible else None


def _transverse_jacobian(config: Config, joints: JointEstimate, preload: PreloadState) -> Array:
    """Compute the loads (5, 3) by unit forces along the tool's y and z axes and a unit torque about x."""
    frames = settle_output(config.arm, joints.output_rad, joints.gravity_R_m_s2, preload.reaction).frames
    X_RT = tool_pose(config.arm, frames, preload.tool)
    J = joint_jacobian(frames, X_RT.p)
    return np.column_stack((J[3:].T @ X_RT.R[:, 1:], J[:3].T @ X_RT.R[:, 0]))


def correct_preload(change: PreloadChange, ratio: ForceRatio) -> PreloadState:
    """Return the preload at the end of a change of force, by the ratio estimated during it."""
    force_N = change.start.force_N + ratio.along * change.change_N
    done = replace(change.start, model_N=change.end_model_N)
    return replace(done, force_ratio=force_N / change.end_model_N, force_ratio_std=ratio.std)
