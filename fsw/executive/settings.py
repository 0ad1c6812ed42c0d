"""What the ground may set while the arm stands: the rover's tilt, and one parameter at a time."""

from dataclasses import fields, is_dataclass, replace
from math import isfinite
from typing import Any, Final

import numpy as np

from fsw.config import Config, configure
from fsw.dictionary.commands import SetParam, SetTilt
from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import CommandAccepted, CommandCompleted, ParamSet, TiltSet
from fsw.dictionary.params import Params
from fsw.dictionary.validity import check_arm, check_limits
from fsw.estimate.reference import forget_joint
from fsw.executive.checks import check_bounds
from fsw.executive.context import CommandContext, check_ready, command_name, refuse, with_events
from fsw.kinematics.transforms import angle_between, gravity_direction

ENCODER_ZERO_PARAMS: Final = ("gear_ratio", "encoder_counts_per_turn", "hardstop_rad")
"""What an encoder zero rests on: a joint of which one of these changes is to be calibrated again."""


def set_tilt(config: Config, context: CommandContext, command: SetTilt) -> CommandContext:
    """Gravity lies as this attitude says, from now on."""
    problem = check_ready(context) or check_bounds(config.params, command)
    if problem is not None:
        return refuse(context, command, problem)
    down_R = gravity_direction(command.roll_rad, command.pitch_rad)
    joints, bound = context.state.joints, config.params.monitors.tilt_rad
    read = joints.imu_R_m_s2 / np.linalg.norm(joints.imu_R_m_s2)
    off = angle_between(read, down_R)
    if off > bound:
        return refuse(
            context,
            command,
            f"the IMU reads gravity {off:.4f} rad from there, at most {bound:.4f} are allowed",
        )
    state = replace(context.state, joints=replace(joints, down_R=down_R))
    return _complete(replace(context, state=state), command, TiltSet(off))


def set_param(config: Config, context: CommandContext, command: SetParam) -> CommandContext:
    """Flight software goes on with another value of one parameter."""
    problem = check_ready(context)
    if problem is not None:
        return refuse(context, command, problem)
    changed = replace_param(config.params, command)
    if isinstance(changed, str):
        return refuse(context, command, changed)
    anew = configure(changed)
    state = replace(context.state, changed_config=anew)
    group, *middle, leaf = command.name.split(".")
    if group == "joints" and leaf in ENCODER_ZERO_PARAMS:
        joint = Joint[middle[0].upper()]
        known = forget_joint(state.joints.reference, joint)
        state = replace(state, joints=replace(state.joints, reference=known))
    evr = ParamSet(command.name, command.value, anew.params_sha256)
    return _complete(replace(context, state=state), command, evr)


def replace_param(params: Params, command: SetParam) -> Params | str:
    """The parameters with one of them set, or why it can not be."""
    changed = _replace_field(params, command.name.split("."), command)
    if isinstance(changed, str):
        return changed
    return next((wrong for wrong in (*check_limits(changed), *check_arm(changed))), changed)


def _complete(
    context: CommandContext, command: SetTilt | SetParam, evr: ParamSet | TiltSet
) -> CommandContext:
    return with_events(
        context, CommandAccepted(command_name(command)), evr, CommandCompleted(command_name(command))
    )


def _replace_field(record: Any, names: list[str], command: SetParam) -> Params | str:
    """The record with the number at this place replaced, or why not."""
    name, *rest = names
    known = [field.name for field in fields(record)]
    if name not in known:
        return f"{command.name}: {name!r} is not a parameter; there are {', '.join(known)}"
    value = getattr(record, name)
    if rest and is_dataclass(value):
        inner = _replace_field(value, rest, command)
        return inner if isinstance(inner, str) else replace(record, **{name: inner})
    if rest or not isinstance(value, int | float):
        return f"{command.name}: not one number; only single numbers can be set"
    if isinstance(value, int) and command.value != int(command.value if isfinite(command.value) else 0):
        return f"{command.name}: must be a whole number, is {command.value}"
    number = int(command.value) if isinstance(value, int) else float(command.value)
    changed: Params = replace(record, **{name: number})
    return changed
