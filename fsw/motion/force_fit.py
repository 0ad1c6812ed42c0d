"""Correction of a preload by the motor currents.

While the overdrive rises, the reaction of the surface adds to the load of every joint; friction, weight and
bias are constant and drop out of the difference between the start and the end of the press. Where an output
crosses its backlash the force does not rise: a slope of the loads would miss that, their difference does not.
Five loads determine three components of force and a torque about the tool axis. An arm of five joints cannot
prevent rotation about that axis: the pads slide, and friction resists.
"""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.evrs import Evr, PreloadMissed
from fsw.estimate.joints import JointEstimate, LoadEstimate
from fsw.kinematics.chain import joint_jacobian, tool_pose
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array
from fsw.messages import Flags, Sensors
from fsw.motion.paths import Setpoint
from fsw.motion.plan import Refusal, estimate_at
from fsw.motion.preload import PRIOR_RATIO_STD, OverdriveSearch, PreloadChange, PreloadState, plan_preload

MIN_CORRECTION_N: Final = 3.0
"""Least correction of a preload that is worth a further path."""
MAX_ERROR_SHARE: Final = 0.1
"""Error of a preload or its standard deviation, as a share of the command, beyond which its end is a miss."""
MAX_CORRECTIONS: Final = 3
"""Legs of a press after its first one."""
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
LOAD_STEP_NM: Final = 3.0
"""Standard deviation of a load between two knots by friction of the output, which holds or drags it.

At the ends of 17 legs on five arms the gears carried up to 11 N m more or less than the outputs, rms 3 N m.
"""
MIN_CYCLES: Final = 2
"""A mean is taken over more cycles than this."""
MIN_KNOTS: Final = 3
"""Knots of the force in a fit: the first, the last complete one, and the present one."""
MIN_RATIO_STD: Final = 0.05
"""Least standard deviation of an estimated force ratio."""
RATIO_RANGE: Final = (0.5, 2.0)
"""Plausible force ratios; any other is rejected."""


@dataclass(frozen=True, slots=True, eq=False)
class LoadMean:
    """Means of the measured loads over a knot of the force, by sums.

    A joint counts in the cycles in which its current shows the load.
    """

    begin_N: float
    """Force of the model at the start."""
    n: Array = field(default_factory=lambda: np.zeros(5))
    sums: Array = field(default_factory=lambda: np.zeros((3, 5)))
    """Sums of the model's force [N], of the load [N m] and of the direction of the motor, (3, 5)."""

    def add_cycle(self, model_N: float, push_Nm: Array, direction: Array, counts: Flags) -> "LoadMean":
        """Return the means with one cycle more."""
        terms = np.stack((np.full_like(push_Nm, model_N), push_Nm, direction)) * counts
        return LoadMean(self.begin_N, self.n + counts, self.sums + terms)

    def complete(self, later: "LoadMean") -> "LoadMean":
        """Return the means with those of a later knot for joints that did not count before it."""
        absent = self.n <= MIN_CYCLES
        n, sums = np.where(absent, later.n, self.n), np.where(absent, later.sums, self.sums)
        return LoadMean(self.begin_N, n, sums)


@dataclass(frozen=True, slots=True, eq=False)
class ForceFit:
    """Measured loads at the start and at the present end of a press, for the force between them."""

    start: PreloadState
    """Preload before the press."""
    legs_left: int = MAX_CORRECTIONS
    """Number of corrections that may follow."""
    knots: tuple[LoadMean, ...] = ()
    """First knot in which each joint counts, last complete knot and present knot of the press."""

    def add_cycle(
        self, model_N: float, step_N: float, push_Nm: Array, direction: Array, counts: Flags
    ) -> "ForceFit":
        """Add one cycle.

        Args:
            step_N: Length of a knot in newtons of the model.
            push_Nm: Loads by the force as measured by the currents, shape (5,).
            counts: Joints whose currents show the load, shape (5,).
        """
        knots = self.knots
        if not knots or model_N >= knots[-1].begin_N + step_N:
            first = tuple(knot.complete(knots[-1]) for knot in knots[:1])
            knots = (*first, *knots[1:][-1:], LoadMean(model_N))
        return replace(self, knots=(*knots[:-1], knots[-1].add_cycle(model_N, push_Nm, direction, counts)))

    def next_leg(self) -> "ForceFit":
        """Return the fit for a further leg."""
        return replace(self, legs_left=self.legs_left - 1)


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
    """Add the currents of this cycle to the fit if the force rises fast enough, by the rate of the overdrive.

    The measured load is the motor torque less friction, and less the load without the force.
    """
    params = config.params.preload
    if rate_N_s <= MIN_RATE_SHARE * params.rate_N_s:
        return fit
    friction, direction = joints.reference.friction_Nm, np.sign(setpoint.rate_rad_s)
    resisting = np.where(np.isfinite(friction), friction, 0.0) * direction
    carried = resisting - config.torque_constant_Nm_A * sensors.current_A
    push = carried - (load.torque_Nm - load.press_torque_Nm)
    # only a motor that turns counts: static friction differs from friction in motion
    follows = joints.motor_rate_rad_s * setpoint.rate_rad_s > 0.5 * setpoint.rate_rad_s**2
    return fit.add_cycle(preload.model_N, params.step_N, push, direction, follows)


def estimate_force_ratio(
    config: Config, fit: ForceFit, joints: JointEstimate, preload: PreloadState
) -> ForceRatio | None:
    """Estimate the force per newton of the model, since the start of a press, by its posterior density.

    The unknowns are the force along the tool axis, two forces across it and the torque about it. Each has a
    Gaussian prior; the measurements are the differences of the measured loads. A joint counts that turned one
    way at both ends. None without measurements, or if the ratio is implausible.
    """
    if len(fit.knots) < MIN_KNOTS:
        return None
    first, last = fit.knots[0], fit.knots[-2]
    counts = (first.n > MIN_CYCLES) & (last.n > MIN_CYCLES)
    first_n, last_n = np.maximum(first.n, 1.0), np.maximum(last.n, 1.0)
    change_N, change_Nm, _ = last.sums / last_n - first.sums / first_n
    counts &= (first.sums[2] * last.sums[2] > 0) & (change_N > 0)
    if not counts.any():
        return None
    reading_Nm = CURRENT_NOISE_A * config.torque_constant_Nm_A * np.sqrt(1.0 / first_n + 1.0 / last_n)
    noise_Nm = np.hypot(reading_Nm, LOAD_STEP_NM)[counts]
    levers = (_force_jacobian(config, joints, preload) * change_N[:, None])[counts] / noise_Nm[:, None]
    prior = np.array([fit.start.force_ratio, 0.0, 0.0, 0.0])
    prior_std = np.array([PRIOR_RATIO_STD, TRANSVERSE_STD, TRANSVERSE_STD, TWIST_STD_M])
    information = np.diag(prior_std**-2) + levers.T @ levers
    weighted_residual = levers.T @ (change_Nm[counts] / noise_Nm - levers @ prior)
    along, *across, _ = prior + np.linalg.solve(information, weighted_residual)
    std = max(float(np.sqrt(np.linalg.inv(information)[0, 0])), MIN_RATIO_STD)
    plausible = RATIO_RANGE[0] < along < RATIO_RANGE[1]
    return ForceRatio(float(along), float(np.hypot(*across)), std) if plausible else None


def _force_jacobian(config: Config, joints: JointEstimate, preload: PreloadState) -> Array:
    """Compute the loads (5, 4) by unit reactions along and across the tool axis, and torque about it."""
    frames = settle_output(config.arm, joints.output_rad, joints.gravity_R_m_s2, preload.reaction).frames
    X_RT = tool_pose(config.arm, frames, preload.tool)
    J = joint_jacobian(frames, X_RT.p)
    return np.column_stack((-J[3:].T @ preload.axis_R, J[3:].T @ X_RT.R[:, 1:], J[:3].T @ X_RT.R[:, 0]))


def correct_preload(change: PreloadChange, start: PreloadState, ratio: ForceRatio) -> PreloadState:
    """Return the preload at the end of a change of force, by the ratio estimated since the press began."""
    force_N = start.force_N + ratio.along * (change.end_model_N - start.model_N)
    done = replace(change.start, model_N=change.end_model_N)
    return replace(done, force_ratio=force_N / change.end_model_N, force_ratio_std=ratio.std)


def plan_correction(
    config: Config,
    change: PreloadChange,
    fit: ForceFit,
    joints: JointEstimate,
    preload: PreloadState,
    planned_for: PreloadState,
) -> OverdriveSearch | Refusal | None:
    """Begin the plan of a further leg of a press.

    The leg starts at the end of the plan: from the estimate, a backlash on which the two differ would be
    crossed to and fro. The wind-up of the gears is that of the corrected force.

    Returns:
        The work of planning it, the reason for none, or None if the force is near the target.
    """
    if abs(change.target_N - preload.force_N) < MIN_CORRECTION_N:
        return None
    if fit.legs_left == 0:
        return Refusal(f"{MAX_CORRECTIONS} corrections did not reach the force")
    extra_Nm = change.torque_per_N * (preload.force_N - planned_for.force_N)
    end = replace(change.end, gear_rad=change.end.gear_rad + extra_Nm / config.arm.gear_stiffness_Nm_rad)
    return plan_preload(config, estimate_at(joints, end), preload, change.target_N)


def report_miss(target_N: float, preload: PreloadState, refused: Refusal | None) -> tuple[Evr, ...]:
    """Report a press whose preload at the end is far from its target or unknown; why no leg corrects it."""
    error_N, max_N = preload.force_ratio_std * preload.model_N, MAX_ERROR_SHARE * target_N
    if error_N > max_N:
        reason = f"motor currents show the force to {error_N:.0f} N only"
    elif refused is not None and abs(target_N - preload.force_N) > max_N:
        reason = refused.reason
    else:
        return ()
    return (PreloadMissed(preload.tool, preload.force_N, target_N, reason),)
