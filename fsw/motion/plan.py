"""Plan joint moves and moves over knots: paths, backlash at their end, or the reason for a refusal."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.enums import Joint
from fsw.estimate.gear import LIKELY, STILL_RAD, bound_gear, gear_after_output_turn
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.soft_limits import describe_outside, limit_excess
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array
from fsw.motion.compensation import Compensation, final_direction
from fsw.motion.paths import Path, Travel, joint_path, line_path

TOO_SOFT: Final = "the arm of these parameters is too soft to hang still"


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a move cannot be."""

    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class JointPositions:
    """Where motors stand and how the outputs lie in their gears."""

    motor_rad: Array
    gear_rad: Array

    @property
    def output_rad(self) -> Array:
        """Where the outputs are."""
        output: Array = self.motor_rad + self.gear_rad
        return output


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Paths to run one after the other, and where they end."""

    paths: tuple[Path, ...]
    end: JointPositions
    gap_rad: Array
    """The backlash that the last set-points allow for."""
    branch: str | None = None
    """The inverse-kinematics branch, where one was chosen."""


def likely_positions(joints: JointEstimate) -> JointPositions:
    """Where the joints are now, as far as is known."""
    return JointPositions(joints.motor_rad, joints.gear_rad[:, LIKELY])


def estimate_at(joints: JointEstimate, stand: JointPositions) -> JointEstimate:
    """The joints where a plan ends, their gears as it has them."""
    gear = np.repeat(stand.gear_rad[:, None], joints.gear_rad.shape[1], axis=1)
    return replace(joints, motor_rad=stand.motor_rad, gear_rad=gear)


def plan_poses(
    config: Config, joints: JointEstimate, poses: list[Array], compensation: Compensation
) -> Plan | Refusal:
    """Joint moves from output pose (5) to output pose, deflection apart; refused beyond the soft limits."""
    paths: list[Path] = []
    here = likely_positions(joints)
    gap = np.zeros_like(here.motor_rad)
    for k, pose in enumerate(poses):
        if worst_limit_excess(config, pose) > 0:
            return Refusal(describe_worst_limit(config, pose))
        hanging = settle_output(config.arm, pose, joints.gravity_R_m_s2)
        if not hanging.converged:
            return Refusal(TOO_SOFT)
        last = k == len(poses) - 1
        leg = plan_joint_move(config, joints, here, pose, hanging.torque_Nm, compensation, on_known_side=last)
        paths.extend(leg.paths)
        here, gap = leg.end, leg.gap_rad
    return Plan(tuple(paths), here, gap)


def plan_joint(
    config: Config, joints: JointEstimate, joint: Joint, angle_rad: float, compensation: Compensation
) -> Plan | Refusal:
    """A move of one joint's output to an angle while the others stay on their brakes."""
    pose = joints.output_rad.copy()
    pose[joint] = angle_rad
    arm = config.arm
    if not arm.soft_min_rad[joint] <= angle_rad <= arm.soft_max_rad[joint]:
        return Refusal(describe_outside(arm, joint, angle_rad))
    hanging = settle_output(arm, pose, joints.gravity_R_m_s2)
    if not hanging.converged:
        return Refusal(TOO_SOFT)
    return plan_joint_move(
        config, joints, likely_positions(joints), pose, hanging.torque_Nm, compensation, only=joint
    )


def plan_joint_move(
    config: Config,
    joints: JointEstimate,
    start: JointPositions,
    output_rad: Array,
    load_Nm: Array,
    compensation: Compensation,
    on_known_side: bool = True,
    only: Joint | None = None,
) -> Plan:
    """A joint move to outputs (5) under the loads there, such that backlash is on a known side at the end.

    Outputs that their load does not hold are dragged to their places. Where the direct way does not do so by
    itself, the move first goes as far beyond as that takes. With `only`, the other motors stay.
    """
    moving = np.array([only in (None, joint) for joint in Joint])
    bounds = bound_gear(config, joints.reference.half_gap_rad, load_Nm)
    gear = gear_after_output_turn(start.gear_rad, output_rad - start.output_rad, bounds)
    if compensation.backlash == "off" or not on_known_side:
        motor = np.where(moving, output_rad - compensation.allowance(joints, gear), start.motor_rad)
        path = joint_path(config, start.motor_rad, motor)
        return Plan((path,), JointPositions(motor, gear), compensation.backlash_allowance(joints, gear))
    run_up = bounds.highest_rad - bounds.lowest_rad + config.params.motion.approach_rad
    direction = moving * final_direction(config, load_Nm, joints.gravity_R_m_s2)
    direction = _reverse_at_limits(config, output_rad, run_up, direction)
    gear = np.where(direction == 0, gear, gear_after_output_turn(gear, direction, bounds))
    motor = np.where(moving, output_rad - compensation.allowance(joints, gear), start.motor_rad)
    short = (direction != 0) & (direction * (motor - start.motor_rad) < run_up)
    before = [np.where(short, motor - direction * run_up, motor)] if short.any() else []
    paths = tuple(joint_path(config, a, b) for a, b in pairwise((start.motor_rad, *before, motor)))
    return Plan(paths, JointPositions(motor, gear), compensation.backlash_allowance(joints, gear))


def _reverse_at_limits(config: Config, output_rad: Array, run_up_rad: Array, direction: Array) -> Array:
    """The directions, turned round where the run-up would leave the soft limits."""
    before = output_rad - direction * run_up_rad
    outside_limits = (before < config.arm.soft_min_rad) | (before > config.arm.soft_max_rad)
    allowed: Array = np.where(outside_limits, -direction, direction)
    return allowed


def worst_limit_excess(config: Config, output_rad: Array) -> Array:
    """By how much the worst joint of (5, ...) is beyond its soft limit; negative is inside."""
    over: Array = limit_excess(config.arm, output_rad).max(axis=0)
    return over


def describe_worst_limit(config: Config, output_rad: Array) -> str:
    """The sentence about the joint of a pose (5) that is farthest beyond its soft limit."""
    joint = Joint(int(np.argmax(limit_excess(config.arm, output_rad))))
    return describe_outside(config.arm, joint, output_rad[joint])


def plan_over_knots(
    config: Config,
    joints: JointEstimate,
    output_rad: Array,
    load_Nm: Array,
    compensation: Compensation,
    travel: Travel,
) -> Plan:
    """Paths over equally spaced outputs (5, k) under their loads (5, k), from where the joints stand.

    Where a gear is to be crossed first, there is a joint move while the outputs stand still; so there is to
    the first outputs, where the joints stand elsewhere.
    """
    step = travel.length / (output_rad.shape[1] - 1)
    stiffness = config.arm.gear_stiffness_Nm_rad
    here = likely_positions(joints)
    paths: list[Path] = []
    gear, knots = here.gear_rad, [here.motor_rad]
    unmade = np.zeros_like(here.gear_rad)
    first = output_rad[:, 0] - compensation.allowance(joints, gear)
    if np.abs(first - here.motor_rad).max() > STILL_RAD:
        paths.append(joint_path(config, here.motor_rad, first))
        knots = [first]
    for k, moved in enumerate(np.diff(output_rad).T, start=1):
        bounds = bound_gear(config, joints.reference.half_gap_rad, load_Nm[:, k])
        wound = (load_Nm[:, k] - load_Nm[:, k - 1]) / stiffness
        # many knots that are each too little to drag an output add up
        unmade = unmade + moved
        new_gear = gear_after_output_turn(gear + wound, unmade, bounds)
        unmade = np.where(np.abs(unmade) > STILL_RAD, 0.0, unmade)
        allowance = compensation.allowance(joints, new_gear)
        crossed = allowance - compensation.allowance(joints, gear + wound)
        if np.abs(crossed).max() > STILL_RAD:
            if len(knots) > 1:
                paths.append(_knot_path(config, knots, step, travel))
            paths.append(joint_path(config, knots[-1], knots[-1] - crossed))
            knots = [knots[-1] - crossed]
        gear = new_gear
        knots.append(output_rad[:, k] - allowance)
    paths.append(_knot_path(config, knots, step, travel))
    return Plan(tuple(paths), JointPositions(knots[-1], gear), compensation.backlash_allowance(joints, gear))


def _knot_path(config: Config, knots: list[Array], step: float, travel: Travel) -> Path:
    return line_path(config, np.array(knots), replace(travel, length=step * (len(knots) - 1)))
