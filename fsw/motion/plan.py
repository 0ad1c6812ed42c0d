"""Plans of joint moves and of moves over knots: paths and the positions at their end, or a refusal.

Set-points are shifted by backlash and deflection, and a move ends on a known side of the backlash. Plans are
made piece by piece (`work.py`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.commands import BacklashMode, DeflectionMode
from fsw.dictionary.enums import Joint
from fsw.dictionary.types import cycle_record
from fsw.estimate.gear import (
    LIKELY,
    STILL_RAD,
    bound_gear,
    clip_to_backlash,
    gear_after_output_turn,
    load_error,
)
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.arm import describe_outside, limit_excess
from fsw.kinematics.statics import relative_target, settle_output
from fsw.kinematics.transforms import Array
from fsw.motion.paths import Path, Travel, joint_path, line_path
from fsw.motion.work import Work

NO_GRAVITY: Final = np.zeros(3)


@dataclass(frozen=True, slots=True)
class Compensation:
    """Compensations of a move; wind-up of the gears counts as deflection."""

    backlash: BacklashMode = "on"
    deflection: DeflectionMode = "absolute"

    def gravity(self, joints: JointEstimate) -> Array:
        """Return the gravity of the deflection model in RMECH, shape (3,); zero if it is off."""
        return NO_GRAVITY if self.deflection == "off" else joints.gravity_R_m_s2

    def allowance(self, joints: JointEstimate, gear_rad: Array) -> Array:
        """Return the part of gear angles by which set-points shift: backlash and wind-up [rad], each or 0."""
        wind_up = gear_rad - clip_to_backlash(joints.reference.half_backlash_rad, gear_rad)
        backlash = self.backlash_allowance(joints, gear_rad)
        allowed: Array = backlash if self.deflection == "off" else backlash + wind_up
        return allowed

    def backlash_allowance(self, joints: JointEstimate, gear_rad: Array) -> Array:
        """Compute the backlash part of `allowance`, in radians, same shape."""
        backlash = clip_to_backlash(joints.reference.half_backlash_rad, gear_rad)
        return backlash if self.backlash == "on" else np.zeros_like(backlash)

    def target(
        self, config: Config, joints: JointEstimate, reference: str, p_RoTo_R_m: Array, approach_R: Array
    ) -> tuple[Array, Array]:
        """Convert a target to one for absolute inverse kinematics.

        Only relative compensation changes it: by the present deflection of the reference tool.
        """
        if self.deflection != "relative":
            return p_RoTo_R_m, approach_R
        return relative_target(
            config.arm, reference, joints.output_rad, joints.gravity_R_m_s2, p_RoTo_R_m, approach_R
        )


def final_direction(config: Config, load_Nm: Array, gravity_R_m_s2: Array) -> Array:
    """Choose the direction, 1 or -1, in which each output (5,) ends its move, so that its side is known.

    It is 0 if the load at the end decides the side. If the load does not decide, the output moves in the
    positive direction and so ends on the negative side of the backlash. If the load may then push it to the
    positive side, it moves in the negative direction and ends there.
    """
    error = load_error(config, gravity_R_m_s2)
    decided = np.abs(load_Nm) > config.output_friction_Nm + error
    pushed = load_Nm > config.output_friction_Nm - error
    direction: Array = np.where(decided, 0.0, np.where(pushed, -1.0, 1.0))
    return direction


TOO_SOFT: Final = "with these parameters, no static equilibrium of the arm is found"


@dataclass(frozen=True, slots=True)
class Refusal:
    """Reason that a move cannot be planned."""

    reason: str
    is_blocked: bool = False
    """True if something is in the way."""


@dataclass(frozen=True, slots=True, eq=False)
class JointPositions:
    """Motor angles and gear angles (output less motor), (5,) each."""

    motor_rad: Array
    gear_rad: Array

    @property
    def output_rad(self) -> Array:
        """Return the output angles in radians, shape (5,)."""
        output: Array = self.motor_rad + self.gear_rad
        return output


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Paths to follow in sequence, and the joints at their end."""

    paths: tuple[Path, ...]
    end: JointPositions
    backlash_rad: Array
    """Backlash that the last set-points allow for, (5,)."""
    branch: str | None = None
    """Inverse-kinematics branch; None if none was chosen."""


def likely_positions(joints: JointEstimate) -> JointPositions:
    """Return the likely positions of the joints."""
    return JointPositions(joints.motor_rad, joints.gear_rad[:, LIKELY])


def estimate_at(joints: JointEstimate, positions: JointPositions) -> JointEstimate:
    """Return the estimate with the joints at these positions, such as the end of a plan."""
    gear = np.repeat(positions.gear_rad[:, None], joints.gear_rad.shape[1], axis=1)
    return replace(joints, motor_rad=positions.motor_rad, gear_rad=gear)


@cycle_record
class PosePlan(Work[Plan | Refusal]):
    """Plan of joint moves through output poses, of which one is planned in each piece of work.

    Only the last move ends on a known side of the backlash.
    """

    joints: JointEstimate
    poses: tuple[Array, ...]
    """Poses that are left, (5,) each."""
    compensation: Compensation
    positions: JointPositions
    """Positions of the joints at the end of the paths so far."""
    paths: tuple[Path, ...] = ()
    only: Joint | None = None
    """Joint that moves while the other motors stay; None if all move."""
    branch: str | None = None
    """Inverse-kinematics branch of the last pose."""

    def advance(self, config: Config) -> "PosePlan | Plan | Refusal":
        """Plan the move to the next pose; a refusal if that is beyond the soft limits."""
        pose, *left = self.poses
        outside = self._find_outside(config, pose)
        if outside is not None:
            return Refusal(outside)
        equilibrium = settle_output(config.arm, pose, self.joints.gravity_R_m_s2)
        if not equilibrium.converged:
            return Refusal(TOO_SOFT)
        leg = plan_joint_move(
            config,
            self.joints,
            self.positions,
            pose,
            equilibrium.torque_Nm,
            self.compensation,
            on_known_side=not left,
            only=self.only,
        )
        paths = self.paths + leg.paths
        if left:
            return replace(self, poses=tuple(left), positions=leg.end, paths=paths)
        return replace(leg, paths=paths, branch=self.branch)

    def _find_outside(self, config: Config, pose: Array) -> str | None:
        excess_rad = limit_excess(config.arm, pose)
        joint = Joint(int(excess_rad.argmax())) if self.only is None else self.only
        return describe_outside(config.arm, joint, pose[joint]) if excess_rad[joint] > 0 else None


def plan_poses(
    joints: JointEstimate, poses: Sequence[Array], compensation: Compensation, branch: str | None = None
) -> PosePlan:
    """Begin a plan of joint moves through output poses, (5,) each, the last one on this branch."""
    return PosePlan(joints, tuple(poses), compensation, likely_positions(joints), branch=branch)


def plan_joint(joints: JointEstimate, joint: Joint, angle_rad: float, compensation: Compensation) -> PosePlan:
    """Begin a plan of a move of one output to an angle while the other joints stay on their brakes."""
    pose = joints.output_rad.copy()
    pose[joint] = angle_rad
    return PosePlan(joints, (pose,), compensation, likely_positions(joints), only=joint)


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
    """Plan a joint move that ends with each output on a known side of its backlash.

    The load holds an output on one side, or the end of the move drags it to one. If the direct move may not
    do that, a first move makes room for the run-up.

    Args:
        on_known_side: False to move directly, whatever the side at the end.
        only: Joint that moves while the other motors stay; None if all move.
    """
    moving = np.array([only in (None, joint) for joint in Joint])
    bounds = bound_gear(config, joints.reference.half_backlash_rad, load_Nm)
    gear = gear_after_output_turn(start.gear_rad, output_rad - start.output_rad, bounds)
    if compensation.backlash == "off" or not on_known_side:
        motor = np.where(moving, output_rad - compensation.allowance(joints, gear), start.motor_rad)
        path = joint_path(config, start.motor_rad, motor)
        return Plan((path,), JointPositions(motor, gear), compensation.backlash_allowance(joints, gear))
    # an uncertain load may leave the output on either flank, so the run-up crosses the whole gap
    widest = bound_gear(config, joints.reference.half_backlash_rad, np.zeros_like(load_Nm))
    run_up = widest.highest_rad - widest.lowest_rad + config.params.motion.takeup_rad
    direction = moving * final_direction(config, load_Nm, joints.gravity_R_m_s2)
    direction = _reverse_at_limits(config, output_rad, run_up, direction)
    gear = np.where(direction == 0, gear, gear_after_output_turn(gear, direction, bounds))
    motor = np.where(moving, output_rad - compensation.allowance(joints, gear), start.motor_rad)
    end = JointPositions(motor, gear)
    undragged = _find_undragged(config, joints, start, end, run_up, direction)
    via = [np.where(undragged, motor - direction * run_up, motor)] if undragged.any() else []
    paths = tuple(joint_path(config, a, b) for a, b in pairwise((start.motor_rad, *via, motor)))
    return Plan(paths, end, compensation.backlash_allowance(joints, gear))


def _find_undragged(
    config: Config,
    joints: JointEstimate,
    start: JointPositions,
    end: JointPositions,
    run_up_rad: Array,
    direction: Array,
) -> Array:
    """Find the outputs (5,) that a direct move does not surely drag to their side.

    It is shorter than the run-up, or where that begins the load may still hold the output on the other side.
    """
    travel = direction * (end.motor_rad - start.motor_rad)
    undragged: Array = (direction != 0) & (travel < run_up_rad)
    long = np.flatnonzero((direction != 0) & (travel >= run_up_rad))
    if long.size:
        share = 1.0 - run_up_rad[long] / travel[long]
        # one pose for each of these joints: that in which its run-up begins
        poses = start.output_rad[:, None] + np.outer(end.output_rad - start.output_rad, share)
        gravity = joints.gravity_R_m_s2
        load_Nm = settle_output(config.arm, poses, gravity).torque_Nm[long, range(long.size)]
        error_Nm = load_error(config, gravity)[long]
        undragged[long] = direction[long] * load_Nm > config.output_friction_Nm[long] - error_Nm
    return undragged


def _reverse_at_limits(config: Config, output_rad: Array, run_up_rad: Array, direction: Array) -> Array:
    """Reverse the directions (5,) whose run-up would leave the soft limits."""
    run_up_start = output_rad - direction * run_up_rad
    outside_limits = (run_up_start < config.arm.soft_min_rad) | (run_up_start > config.arm.soft_max_rad)
    allowed: Array = np.where(outside_limits, -direction, direction)
    return allowed


def worst_limit_excess(config: Config, output_rad: Array) -> Array:
    """Compute the largest excess of a joint over its soft limit, (...) [rad]; negative inside all limits."""
    excess: Array = limit_excess(config.arm, output_rad).max(axis=0)
    return excess


def describe_worst_limit(config: Config, output_rad: Array) -> str:
    """Describe the joint of a pose, shape (5,), that is farthest beyond its soft limit."""
    joint = Joint(int(np.argmax(limit_excess(config.arm, output_rad))))
    return describe_outside(config.arm, joint, output_rad[joint])


KNOTS: Final = 16
"""Knots in a piece of work: each takes some 40 us, a joint move between two of them 200 us."""


@cycle_record
class KnotPlan(Work[Plan]):
    """Plan of paths over equally spaced outputs, from the present positions.

    If a gear crosses its backlash at a knot, a joint move inserted there crosses it while the outputs rest.
    If the joints are not at the first outputs, a joint move to these comes first.
    """

    joints: JointEstimate
    output_rad: Array
    """Outputs at the knots, (5, k)."""
    load_Nm: Array
    """Loads at the knots, (5, k)."""
    compensation: Compensation
    travel: Travel
    """Length of all knots together, and bounds of speed, acceleration and jerk."""
    gear_rad: Array
    """Gear angles at the last knot, (5,)."""
    pending_turn_rad: Array
    """Turns of the outputs, (5,), that have been too small to drag them."""
    knots: tuple[Array, ...]
    """Motor angles, (5,) each, of the knots of the present path."""
    paths: tuple[Path, ...]
    done: int = 1
    """Knots that are done."""

    def advance(self, config: Config) -> "KnotPlan | Plan":
        """Plan over the next knots."""
        plan = self
        for k in range(self.done, min(self.done + KNOTS, self.output_rad.shape[1])):
            plan = plan._over_knot(config, k)
        if plan.done < self.output_rad.shape[1]:
            return plan
        last = knot_path(config, plan.knots, plan.step, plan.travel)
        end = JointPositions(plan.knots[-1], plan.gear_rad)
        backlash_rad = plan.compensation.backlash_allowance(plan.joints, plan.gear_rad)
        return Plan((*plan.paths, last), end, backlash_rad)

    @property
    def step(self) -> float:
        """Return the travel from one knot to the next."""
        intervals: int = self.output_rad.shape[1] - 1
        return self.travel.length / intervals

    def _over_knot(self, config: Config, k: int) -> "KnotPlan":
        joints, knots, paths = self.joints, self.knots, self.paths
        load_Nm, last_load_Nm = self.load_Nm[:, k], self.load_Nm[:, k - 1]
        bounds = bound_gear(config, joints.reference.half_backlash_rad, load_Nm)
        wind_up = (load_Nm - last_load_Nm) / config.arm.gear_stiffness_Nm_rad
        # steps that are each too small to drag an output add up over many knots
        turn = self.pending_turn_rad + (self.output_rad[:, k] - self.output_rad[:, k - 1])
        gear = gear_after_output_turn(self.gear_rad + wind_up, turn, bounds)
        allowance = self.compensation.allowance(joints, gear)
        crossed = allowance - self.compensation.allowance(joints, self.gear_rad + wind_up)
        if np.abs(crossed).max() > STILL_RAD:
            if len(knots) > 1:
                paths = (*paths, knot_path(config, knots, self.step, self.travel))
            paths = (*paths, joint_path(config, knots[-1], knots[-1] - crossed))
            knots = (knots[-1] - crossed,)
        return replace(
            self,
            gear_rad=gear,
            pending_turn_rad=np.where(np.abs(turn) > STILL_RAD, 0.0, turn),
            knots=(*knots, self.output_rad[:, k] - allowance),
            paths=paths,
            done=k + 1,
        )


def plan_over_knots(
    config: Config,
    joints: JointEstimate,
    output_rad: Array,
    load_Nm: Array,
    compensation: Compensation,
    travel: Travel,
) -> KnotPlan:
    """Begin a plan of paths over knots; outputs and loads have shape (5, k)."""
    start = likely_positions(joints)
    first = output_rad[:, 0] - compensation.allowance(joints, start.gear_rad)
    is_there = np.abs(first - start.motor_rad).max() <= STILL_RAD
    return KnotPlan(
        joints=joints,
        output_rad=output_rad,
        load_Nm=load_Nm,
        compensation=compensation,
        travel=travel,
        gear_rad=start.gear_rad,
        pending_turn_rad=np.zeros_like(start.gear_rad),
        knots=(start.motor_rad if is_there else first,),
        paths=() if is_there else (joint_path(config, start.motor_rad, first),),
    )


def knot_path(config: Config, knots: tuple[Array, ...], step: float, travel: Travel) -> Path:
    """Compute the path over knots, (5,) each, at equal steps of the travel."""
    return line_path(config, np.array(knots), replace(travel, length=step * (len(knots) - 1)))
