"""Settings that the ground may change while the arm stands: the rover's tilt, and single parameters."""

from dataclasses import fields, is_dataclass, replace
from typing import Any, Final

import numpy as np

from fsw.config import Config, configure, configure_at
from fsw.dictionary.commands import Command, SetParam, SetTilt
from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import CommandAccepted, CommandCompleted, Evr, ParamSet, TiltSet
from fsw.dictionary.params import Params
from fsw.dictionary.validity import check_arm, check_limits
from fsw.estimate.joints import JointEstimate
from fsw.estimate.reference import forget_joint
from fsw.executive.context import CommandContext, check_ready, command_name, refuse, with_events
from fsw.kinematics.transforms import angle_between, gravity_direction

ENCODER_ZERO_PARAMS: Final = ("gear_ratio", "encoder_counts_per_turn", "hardstop_rad")
"""Parameters that an encoder zero depends on; if one changes, its joint must be calibrated again."""


def set_tilt(config: Config, context: CommandContext, command: SetTilt) -> CommandContext:
    """Set the direction of gravity from the attitude of the rover; refuse one that the IMU contradicts."""
    problem = check_ready(context)
    if problem is not None:
        return refuse(context, command, problem)
    tilted = tilt_joints(config, context.state.joints, command)
    if isinstance(tilted, str):
        return refuse(context, command, tilted)
    joints, difference_rad = tilted
    state = replace(context.state, joints=joints)
    return _complete(replace(context, state=state), command, TiltSet(difference_rad))


def tilt_joints(config: Config, joints: JointEstimate, command: SetTilt) -> tuple[JointEstimate, float] | str:
    """Return the estimate with gravity from an attitude, or the reason that the attitude is refused.

    Returns:
        The estimate, and the angle [rad] between this gravity and that of the IMU.
    """
    down_R, bound = gravity_direction(command.roll_rad, command.pitch_rad), config.params.monitors.tilt_rad
    difference_rad = angle_between(joints.imu_R_m_s2 / np.linalg.norm(joints.imu_R_m_s2), down_R)
    if difference_rad > bound:
        return f"the IMU reads gravity {difference_rad:.4f} rad from there, at most {bound:.4f} are allowed"
    return replace(joints, down_R=down_R), difference_rad


def set_param(config: Config, context: CommandContext, command: SetParam) -> CommandContext:
    """Set one parameter, and forget an encoder zero that depends on it."""
    problem = check_ready(context)
    if problem is not None:
        return refuse(context, command, problem)
    changed = replace_param(config.params, command)
    if isinstance(changed, str):
        return refuse(context, command, changed)
    changed_config = configure_at(configure(changed), config.structure_C)
    state = replace(context.state, changed_config=changed_config)
    group, *middle, leaf = command.name.split(".")
    if group == "joints" and leaf in ENCODER_ZERO_PARAMS:
        joint = Joint[middle[0].upper()]
        reference = forget_joint(state.joints.reference, joint)
        state = replace(state, joints=replace(state.joints, reference=reference))
    evr = ParamSet(command.name, command.value, changed_config.params_sha256)
    return _complete(replace(context, state=state), command, evr)


def replace_param(params: Params, command: SetParam) -> Params | str:
    """Return the parameters with one of them replaced, or the reason that this is not valid."""
    changed = _replace_field(params, command.name.split("."), command)
    if isinstance(changed, str):
        return changed
    return next(iter((*check_limits(changed), *check_arm(changed))), changed)


def _complete(context: CommandContext, command: Command, evr: Evr) -> CommandContext:
    return with_events(
        context, CommandAccepted(command_name(command)), evr, CommandCompleted(command_name(command))
    )


def _replace_field(record: Any, names: list[str], command: SetParam) -> Params | str:
    """Return a record with the number under these names replaced, or the reason that it cannot be."""
    name, *rest = names
    field_names = [field.name for field in fields(record)]
    if name not in field_names:
        return f"{command.name}: {name!r} is not a parameter; there are {', '.join(field_names)}"
    value = getattr(record, name)
    if rest and is_dataclass(value):
        inner = _replace_field(value, rest, command)
        return inner if isinstance(inner, str) else replace(record, **{name: inner})
    if rest or not isinstance(value, int | float):
        return f"{command.name}: not one number; only single numbers can be set"
    if isinstance(value, int) and not command.value.is_integer():
        return f"{command.name}: must be a whole number, is {command.value}"
    number = int(command.value) if isinstance(value, int) else command.value
    changed: Params = replace(record, **{name: number})
    return changed
