"""Pressing without a force sensor: overdrive through the modelled stiffness of the arm."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.enums import Tool
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.statics import ToolForce, settle_output
from fsw.kinematics.task import ROOT_TOLERANCE, task_error, task_jacobian
from fsw.kinematics.transforms import Array
from fsw.motion.compensation import Compensation
from fsw.motion.path_check import check_paths
from fsw.motion.paths import Travel
from fsw.motion.plan import TOO_SOFT, Plan, Refusal, Stand, over_limits, worst_limit
from fsw.motion.plan_knots import plan_through

STEPS: Final = 20
ROUNDING_N: Final = 1e-6
RAMP_S: Final = 1.0
"""In which the rate of the force builds up."""
UNFELT: Final = 0.25
"""By how much a built arm's stiffness may well differ from the model's."""
SURE: Final = 0.1
"""So well is it known once it was felt."""
WORST: Final = 1.5
"""Times that the stiffness may well be off."""
FRICTION_FACTOR: Final = 1.5
"""Friction may have risen by so much since it was felt at the hardstop."""


@dataclass(frozen=True, slots=True, eq=False)
class Pressing:
    """A tool that presses: where it touched, how it looked there, and how far the arm is overdriven since.

    The overdrive is counted in newtons of the model: with so many the modelled arm would press. The built arm
    is stiffer or softer, and presses with a share of them.
    """

    tool: Tool
    p_RoTo_R_m: Array
    axis_R: Array
    model_N: float
    rest_rad: Array
    """How far the resolvers were from the believed outputs when it touched, (5,)."""
    share: float = 1.0
    """True over modelled force, as far as it was felt."""
    share_unsure: float = UNFELT
    """Standard deviation of what is to be felt next."""

    @property
    def force_N(self) -> float:
        """With what it is believed to press."""
        return self.share * self.model_N

    def push(self, force_N: Array | float) -> ToolForce:
        """What comes back of a force or forces (...)."""
        column = self.axis_R.reshape(3, *(1,) * np.ndim(force_N))
        return ToolForce(self.tool, -column * force_N)

    @property
    def pushed(self) -> ToolForce:
        """What comes back of the force as it is believed to be."""
        return self.push(self.force_N)


@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """A change of force under way, to its end or to where it is to be felt first."""

    start: Pressing
    end_model_N: float
    wanted_N: float
    torque_per_N: Array
    """By how much each joint's load rises with the force, (5,)."""
    free_Nm: Array
    """What the joints carry without it, (5,)."""
    end: Stand
    """Of the motors and gears."""

    @property
    def change_N(self) -> float:
        """Of the model's force."""
        return self.end_model_N - self.start.model_N

    def after(self, travelled_N: float) -> Pressing:
        """What is pressed with when so much of the change is done."""
        if travelled_N >= abs(self.change_N) - ROUNDING_N:
            return replace(self.start, model_N=self.end_model_N)
        return replace(self.start, model_N=self.start.model_N + float(np.sign(self.change_N)) * travelled_N)


def firm_N(config: Config) -> float:
    """With what a touch ends, so that the tool stays in contact: one step more than closes its switch."""
    return config.params.motion.switch_force_N + config.params.preload.step_N


def touched(config: Config, joints: JointEstimate, tool: Tool) -> Pressing:
    """A tool that touches with what closes its switch: so little pushes it that friction does not count."""
    arm, gravity, force_N = config.arm, joints.gravity_R_m_s2, config.params.motion.switch_force_N
    free = tool_pose(arm, settle_output(arm, joints.output_rad, gravity).frames, tool)
    push = ToolForce(tool, -free.R[:, 0] * force_N)
    pushed = tool_pose(arm, settle_output(arm, joints.output_rad, gravity, push).frames, tool)
    return Pressing(tool, pushed.p, pushed.R[:, 0], force_N, joints.resolver_error_rad)


def plan_press(
    config: Config, joints: JointEstimate, pressing: Pressing, force_N: float
) -> tuple[Plan, Press] | Refusal:
    """The overdrive from one force to another, such that the tool stays where it touches and looks as it did.

    What the arm gives way, sideways and in its angle too, is made up for at every force on the way, so
    nothing is left for friction to hold.
    """
    preload = config.params.preload
    end_N = _first_aim(pressing, force_N) / pressing.share
    change_N = abs(end_N - pressing.model_N)
    forces = np.linspace(pressing.model_N, end_N, int(np.ceil(change_N / preload.step_N)) + 1)
    output = _outputs(config, joints, pressing, forces)
    if output is None:
        return Refusal(f"no overdrive found from {pressing.force_N:.1f} to {force_N:.1f} N")
    over = over_limits(config, output)
    if np.any(over > 0):
        k = int(np.argmax(over > 0))
        return Refusal(f"at {pressing.share * forces[k]:.1f} N, {worst_limit(config, output[:, k])}")
    pushed = settle_output(config.arm, output, joints.gravity_R_m_s2, pressing.push(forces))
    carried = settle_output(config.arm, output, joints.gravity_R_m_s2, pressing.push(pressing.share * forces))
    if not (np.all(pushed.converged) and np.all(carried.converged)):
        return Refusal(TOO_SOFT)
    load_Nm, carried_Nm = pushed.torque_Nm, carried.torque_Nm
    travel = Travel(change_N, preload.rate_N_s, preload.rate_N_s / RAMP_S, 2 * preload.rate_N_s / RAMP_S**2)
    # gaps are crossed under the believed force; what the model winds gears up beyond that is overdrive
    overdriven = output - (load_Nm - carried_Nm) / config.arm.gear_stiffness_Nm_rad[:, None]
    plan = plan_through(config, joints, overdriven, carried_Nm, Compensation(), travel)
    meeting = check_paths(config, joints, plan.paths, config.params.collision.padding_m, pressing.tool)
    if meeting is not None:
        return Refusal(meeting)
    per_N = (load_Nm[:, -1] - load_Nm[:, 0]) / (end_N - pressing.model_N)
    free_Nm = load_Nm[:, 0] - per_N * pressing.model_N
    return plan, Press(pressing, end_N, force_N, per_N, free_Nm, plan.end)


def _first_aim(pressing: Pressing, force_N: float) -> float:
    """The force to go to: all of it, or, while little is known of the stiffness, what cannot be too much."""
    if pressing.share_unsure <= SURE or force_N <= pressing.force_N:
        return force_N
    return pressing.force_N + (force_N - pressing.force_N) / (1 + WORST * pressing.share_unsure)


def press_limit_A(config: Config, joints: JointEstimate, press: Press) -> Array:
    """Current limits (5) that stall the motors before the force is much larger than it ought to be."""
    most_N = max(press.start.force_N, press.wanted_N) * (1 + config.params.preload.guard_share)
    carried = np.abs(press.free_Nm) + np.abs(press.torque_per_N) * most_N
    torque = carried + FRICTION_FACTOR * joints.reference.friction_Nm
    limit: Array = np.minimum(torque / config.torque_constant_Nm_A, config.current_limit_A)
    return limit


def _outputs(config: Config, joints: JointEstimate, pressing: Pressing, forces: Array) -> Array | None:
    """Outputs (5, k) at which the pushed arm keeps the tool where it touches; None if there are none."""
    arm, push, tool = config.arm, pressing.push(forces), pressing.tool
    p, axis = pressing.p_RoTo_R_m[:, None], pressing.axis_R[:, None]
    output = np.tile(joints.output_rad[:, None], forces.size)
    for _ in range(STEPS):
        hanging = settle_output(arm, output, joints.gravity_R_m_s2, push)
        X_RT = tool_pose(arm, hanging.frames, tool)
        error = task_error(X_RT, p, axis)
        if np.abs(error).max() < ROOT_TOLERANCE:
            return output
        J = np.moveaxis(task_jacobian(hanging.frames, X_RT, axis), -1, 0)
        # the pseudo-inverse has an answer at a singularity too
        output = output - (np.linalg.pinv(J) @ np.moveaxis(error, -1, 0)[..., None])[..., 0].T
    return None
