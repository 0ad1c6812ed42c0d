"""Preload without a force sensor: overdrive through the modelled stiffness.

`force_fit.py` corrects it by the motor currents.
"""

from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.types import cycle_record
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.statics import (
    ROOT_TOLERANCE,
    Equilibrium,
    ToolForce,
    settle_output,
    task_error,
    task_jacobian,
)
from fsw.kinematics.transforms import Array
from fsw.motion.clearance import PathCheck, check_paths
from fsw.motion.paths import Travel
from fsw.motion.plan import (
    TOO_SOFT,
    Compensation,
    JointPositions,
    KnotPlan,
    Plan,
    Refusal,
    describe_worst_limit,
    estimate_at,
    plan_over_knots,
    worst_limit_excess,
)
from fsw.motion.work import Work

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
        """Return the reaction in RMECH on a tool that has this force on the surface, batch (...)."""
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


def model_contact(config: Config, joints: JointEstimate, tool: str) -> PreloadState:
    """Model the preload of a tool that has just touched with the force that closes its switch.

    Friction is neglected at so small a force.
    """
    arm, gravity, force_N = config.arm, joints.gravity_R_m_s2, config.params.motion.switch_force_N
    free = tool_pose(arm, settle_output(arm, joints.output_rad, gravity).frames, tool)
    push = ToolForce(tool, -free.R[:, 0] * force_N)
    pushed = tool_pose(arm, settle_output(arm, joints.output_rad, gravity, push).frames, tool)
    return PreloadState(tool, pushed.p, pushed.R[:, 0], force_N, joints.resolver_error_rad)


def anchor_contact(config: Config, joints: JointEstimate, preload: PreloadState) -> PreloadState:
    """Return the preload of a tool that rests where it is now, under the same force.

    A tool that hardly presses may slide before the press begins. A press to the place of the touch would then
    push it aside.
    """
    settled = settle_output(config.arm, joints.output_rad, joints.gravity_R_m_s2, preload.reaction)
    X_RT = tool_pose(config.arm, settled.frames, preload.tool)
    return replace(preload, p_RoTo_R_m=X_RT.p, axis_R=X_RT.R[:, 0])


def locate_by_resolvers(joints: JointEstimate, preload: PreloadState) -> JointEstimate:
    """Return the estimate with the outputs where the resolvers have moved to since the contact.

    An output that is elsewhere than planned pushes the tool aside. A resolver is believed as far as the
    uncertainty of the gear angle.
    """
    lowest, likely, highest = joints.gear_rad.T
    error_rad = joints.resolver_error_rad - preload.resolver_offset_rad
    gear = np.clip(likely + error_rad, lowest, highest)
    return estimate_at(joints, JointPositions(joints.motor_rad, gear))


@dataclass(frozen=True, slots=True, eq=False)
class PressPlan(Plan):
    """Plan of a leg of a press."""

    change: PreloadChange = field(kw_only=True)


@cycle_record
class OverdriveSearch(Work[PressPlan | Refusal]):
    """Search of the outputs that keep the tool at its contact pose under forces; the plan of a leg follows.

    Each knot compensates the deflection of the arm in position and direction, so the tool does not need
    friction to stay in place.
    """

    joints: JointEstimate
    preload: PreloadState
    target_N: float
    """Commanded force."""
    model_N: Array
    """Forces at the knots of this leg in newtons of the model, (k,)."""
    output_rad: Array
    """Outputs at the knots, (5, k)."""
    steps: int = 0
    """Newton steps that were taken."""
    pushed: Equilibrium | None = None
    """Equilibrium at the knots; None until the outputs are found."""

    def advance(self, config: Config) -> "OverdriveSearch | LegPlan | Refusal":
        """Take a Newton step; after the last one, begin the plan over the knots."""
        if self.pushed is not None:
            return self._plan(config, self.pushed)
        arm, preload, output = config.arm, self.preload, self.output_rad
        p, axis = preload.p_RoTo_R_m[:, None], preload.axis_R[:, None]
        push = preload.reaction_at(self.model_N)
        pushed = settle_output(arm, output, self.joints.gravity_R_m_s2, push)
        X_RT = tool_pose(arm, pushed.frames, preload.tool)
        error = task_error(X_RT, p, axis)
        if np.abs(error).max() < ROOT_TOLERANCE:
            return replace(self, pushed=pushed)
        if self.steps + 1 == MAX_NEWTON_STEPS:
            return Refusal(f"no overdrive found from {preload.force_N:.1f} to {self.target_N:.1f} N")
        J = np.moveaxis(task_jacobian(pushed.frames, X_RT, axis), -1, 0)
        # the pseudo-inverse exists at a singularity too
        output = output - (np.linalg.pinv(J) @ np.moveaxis(error, -1, 0)[..., None])[..., 0].T
        return replace(self, output_rad=output, steps=self.steps + 1)

    def _plan(self, config: Config, pushed: Equilibrium) -> "LegPlan | Refusal":
        output, model_N, preload = self.output_rad, self.model_N, self.preload
        excess = worst_limit_excess(config, output)
        if np.any(excess > 0):
            k = int(np.argmax(excess > 0))
            force_N = preload.force_ratio * model_N[k]
            return Refusal(f"at {force_N:.1f} N, {describe_worst_limit(config, output[:, k])}")
        gravity, reaction = self.joints.gravity_R_m_s2, preload.reaction_at(preload.force_ratio * model_N)
        carried = settle_output(config.arm, output, gravity, reaction)
        if not (np.all(pushed.converged) and np.all(carried.converged)):
            return Refusal(TOO_SOFT)
        params, load_Nm = config.params.preload, pushed.torque_Nm
        change_N = float(model_N[-1] - model_N[0])
        travel = Travel(
            abs(change_N), params.rate_N_s, params.rate_N_s / RAMP_S, 2 * params.rate_N_s / RAMP_S**2
        )
        # outputs cross their backlash under the estimated force; wind-up beyond that is overdrive
        wind_up = (load_Nm - carried.torque_Nm) / config.arm.gear_stiffness_Nm_rad[:, None]
        knots = plan_over_knots(
            config, self.joints, output - wind_up, carried.torque_Nm, Compensation(), travel
        )
        per_N = (load_Nm[:, -1] - load_Nm[:, 0]) / change_N
        free_Nm = load_Nm[:, 0] - per_N * preload.model_N
        return LegPlan(self.joints, preload, float(model_N[-1]), self.target_N, per_N, free_Nm, knots)


@cycle_record
class LegPlan(Work[PressPlan | Refusal]):
    """Plan of a leg of a press over its knots, and the check of its paths."""

    joints: JointEstimate
    preload: PreloadState
    end_N: float
    """Overdrive at the end of the leg, in newtons of the model."""
    target_N: float
    torque_per_N: Array
    free_Nm: Array
    knots: KnotPlan | Plan
    check: PathCheck | None = None
    """Check of the paths of the plan; None before there is one."""

    def advance(self, config: Config) -> "LegPlan | PressPlan | Refusal":
        """Plan over the next knots, then check the paths."""
        plan = self.knots
        if isinstance(plan, KnotPlan):
            plan = plan.advance(config)
            return replace(self, knots=plan)
        if self.check is None:
            padding_m = config.params.collision.padding_m
            return replace(self, check=check_paths(self.joints, plan.paths, padding_m, self.preload.tool))
        check = self.check.advance(config)
        if isinstance(check, PathCheck):
            return replace(self, check=check)
        if check is not None:
            return Refusal(check)
        change = PreloadChange(
            self.preload, self.end_N, self.target_N, self.torque_per_N, self.free_Nm, plan.end
        )
        return PressPlan(plan.paths, plan.end, plan.backlash_rad, change=change)


def plan_preload(
    config: Config, joints: JointEstimate, preload: PreloadState, force_N: float
) -> OverdriveSearch:
    """Begin the plan of the overdrive from one force to another at a constant pose of the tool.

    While the stiffness of the arm is not known, the leg ends short of the commanded force.
    """
    end_N = _first_force_N(preload, force_N) / preload.force_ratio
    intervals = int(np.ceil(abs(end_N - preload.model_N) / config.params.preload.step_N))
    model_N = np.linspace(preload.model_N, end_N, intervals + 1)
    output = np.tile(joints.output_rad[:, None], model_N.size)
    return OverdriveSearch(joints, preload, force_N, model_N, output)


def _first_force_N(preload: PreloadState, force_N: float) -> float:
    """Return the force of the first leg: less than commanded while the force ratio is not known."""
    if preload.force_ratio_std <= ESTIMATED_RATIO_STD or force_N <= preload.force_N:
        return force_N
    return preload.force_N + (force_N - preload.force_N) / (1 + RATIO_SIGMAS * preload.force_ratio_std)


def preload_limit_A(config: Config, joints: JointEstimate, change: PreloadChange) -> Array:
    """Compute current limits, (5,), that stall the motors before the force much exceeds the commanded one."""
    max_force_N = max(change.start.force_N, change.target_N) * (
        1 + config.params.preload.current_margin_share
    )
    carried_Nm = np.abs(change.free_Nm) + np.abs(change.torque_per_N) * max_force_N
    torque = carried_Nm + FRICTION_FACTOR * joints.reference.friction_Nm
    limit: Array = np.minimum(torque / config.torque_constant_Nm_A, config.current_limit_A)
    return limit
