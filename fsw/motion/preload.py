"""Preload without a force sensor: overdrive through the modelled stiffness.

`force_fit.py` corrects it by the motor currents.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.statics import ROOT_TOLERANCE, ToolForce, settle_output, task_error, task_jacobian
from fsw.kinematics.transforms import Array
from fsw.motion.paths import Travel, check_paths
from fsw.motion.plan import (
    TOO_SOFT,
    Compensation,
    JointPositions,
    Plan,
    Refusal,
    describe_worst_limit,
    estimate_at,
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


def plan_preload(
    config: Config, joints: JointEstimate, preload: PreloadState, force_N: float
) -> tuple[Plan, PreloadChange] | Refusal:
    """Plan the overdrive from one force to another at a constant pose of the tool.

    Each knot compensates the deflection of the arm in position and direction, so the tool does not need
    friction to stay in place. While the stiffness of the arm is not known, plan and change of force end short
    of the commanded force.
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
    """Compute current limits, (5,), that stall the motors before the force much exceeds the commanded one."""
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
