"""From a tool target to a joint move: branch choice and compensation."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fsw.config import Config
from fsw.dictionary.commands import ROVER, MoveTool
from fsw.dictionary.enums import Frame, Tool
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.branches import BRANCHES
from fsw.kinematics.chain import Frames, tool_pose
from fsw.kinematics.ik import BranchVerdict, IkResult, describe_slot, inverse_kinematics, select_result
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array, Pose
from fsw.motion.compensation import Compensation
from fsw.motion.path_check import check_paths
from fsw.motion.plan import Plan, Refusal, plan_to, standing
from fsw.motion.plan_line import plan_straight

AUTO = "AUTO"


def plan_tool(
    config: Config, joints: JointEstimate, command: MoveTool, reference: Tool | None = None
) -> Plan | Refusal:
    """A joint move to the quickest valid and clear branch from where the joints are, or to the named one.

    A branch is valid if the target and the end of the straight travel after it are within limits. Relative
    to `reference`, or else to the tool itself, a target moves along with that tool's deflection of now.
    """
    compensation = Compensation(command.backlash, command.deflection)
    p_m, approach = _in_rover(config, joints, command, compensation)
    along = np.array([0.0, command.line_m])
    targets, approaches = compensation.target(
        config,
        joints,
        command.tool if reference is None else reference,
        p_m[:, None] + approach[:, None] * along,
        np.tile(approach[:, None], 2),
    )
    if command.straight:
        plan = plan_straight(config, joints, command, targets[:, 0], approaches[:, 0])
        return plan if isinstance(plan, Refusal) else _if_clear(config, joints, plan)
    answers = inverse_kinematics(
        config.arm, command.tool, targets, approaches, compensation.gravity(joints), joints.motor_rad
    )
    valid = np.all(answers.verdict == BranchVerdict.VALID, axis=-1)
    names = [BRANCHES[slot % len(BRANCHES)] for slot in range(len(valid))]
    wanted = np.array([command.branch in (AUTO, name) for name in names])
    if not np.any(valid & wanted):
        return Refusal(_why_none(config, command.tool, answers, wanted))
    output = np.where(valid & wanted, answers.output_rad[..., 0], np.nan)
    return _first_clear(config, joints, command, compensation, output, names)


def _first_clear(
    config: Config,
    joints: JointEstimate,
    command: MoveTool,
    compensation: Compensation,
    output_rad: Array,
    names: list[str],
) -> Plan | Refusal:
    """The quickest of the poses (5, slots) to which the way is clear; NaN is none."""
    turns_s = np.max(np.abs(output_rad - joints.output_rad[:, None]) / config.speed_rad_s[:, None], axis=0)
    met = []
    for slot in np.argsort(turns_s)[: np.count_nonzero(np.isfinite(turns_s))]:
        pose = output_rad[:, slot]
        load_Nm = settle_output(config.arm, pose, joints.gravity_R_m_s2).torque_Nm
        plan = _if_clear(
            config, joints, plan_to(config, joints, standing(joints), pose, load_Nm, compensation)
        )
        if not isinstance(plan, Refusal):
            return replace(plan, branch=names[slot])
        met.append(f"{names[slot]}: {plan.reason}")
    return Refusal(f"{command.tool.name}: {met[0]}")


def _if_clear(config: Config, joints: JointEstimate, plan: Plan) -> Plan | Refusal:
    meeting = check_paths(config, joints, plan.paths, config.params.collision.padding_m)
    return plan if meeting is None else Refusal(meeting)


def _in_rover(
    config: Config, joints: JointEstimate, command: MoveTool, compensation: Compensation
) -> tuple[Array, Array]:
    """Position and unit approach in RMECH."""
    p_m, approach = np.array(command.p_FoTo_F_m), np.array(command.approach_F)
    if command.frame != ROVER:
        frames = settle_output(config.arm, joints.output_rad, compensation.gravity(joints)).frames
        X_RF = _frame(config, frames, command.frame)
        p_m, approach = X_RF.R @ p_m + X_RF.p, X_RF.R @ approach
    return p_m, approach / np.linalg.norm(approach)


def _frame(config: Config, frames: Frames, name: str) -> Pose:
    """An arm frame or a tool, by its name."""
    if name in Tool.__members__:
        return tool_pose(config.arm, frames, Tool[name])
    k = Frame[name]
    return Pose(frames.X_RF.R[:, :, k], frames.X_RF.p[:, k])


def _why_none(config: Config, tool: Tool, answers: IkResult, wanted: NDArray[np.bool_]) -> str:
    """Of the branches asked for, the reason of the nearest: at the target, else at the end of the line."""
    for place, name in ((0, "the target"), (1, "the end of the approach")):
        verdict, excess = answers.verdict[:, place], answers.excess[:, place]
        if not np.any(wanted & (verdict == BranchVerdict.VALID)):
            # by verdict first, a limit is nearer than reach, then by how much
            nearest = int(np.lexsort((excess, verdict, ~wanted))[0])
            return f"{tool.name}: {name}: {describe_slot(config.arm, select_result(answers, place), nearest)}"
    return f"{tool.name}: no branch asked for reaches the target and the end of the approach alike"
