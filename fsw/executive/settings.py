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
from fsw.executive.checks import beyond
from fsw.executive.situation import Situation, name_of, not_now, refused, told
from fsw.kinematics.transforms import angle_between, gravity_direction

COUNTED_FROM: Final = ("gear_ratio", "encoder_counts_per_turn", "hardstop_rad")
"""What an encoder zero rests on: a joint of which one of these changes is to be calibrated again."""


def set_tilt(config: Config, now: Situation, command: SetTilt) -> Situation:
    """Gravity lies as this attitude says, from now on."""
    problem = not_now(now) or beyond(config.params, command)
    if problem is not None:
        return refused(now, command, problem)
    down_R = gravity_direction(command.roll_rad, command.pitch_rad)
    joints, bound = now.state.joints, config.params.monitors.tilt_rad
    read = joints.imu_R_m_s2 / np.linalg.norm(joints.imu_R_m_s2)
    off = angle_between(read, down_R)
    if off > bound:
        return refused(
            now, command, f"the IMU reads gravity {off:.4f} rad from there, at most {bound:.4f} are allowed"
        )
    state = replace(now.state, joints=replace(joints, down_R=down_R))
    return _done(replace(now, state=state), command, TiltSet(off))


def set_param(config: Config, now: Situation, command: SetParam) -> Situation:
    """Flight software goes on with another value of one parameter."""
    problem = not_now(now)
    if problem is not None:
        return refused(now, command, problem)
    changed = params_with(config.params, command)
    if isinstance(changed, str):
        return refused(now, command, changed)
    anew = configure(changed)
    state = replace(now.state, changed=anew)
    group, *middle, leaf = command.name.split(".")
    if group == "joints" and leaf in COUNTED_FROM:
        joint = Joint[middle[0].upper()]
        known = forget_joint(state.joints.reference, joint)
        state = replace(state, joints=replace(state.joints, reference=known))
    evr = ParamSet(command.name, command.value, anew.params_sha256)
    return _done(replace(now, state=state), command, evr)


def params_with(params: Params, command: SetParam) -> Params | str:
    """The parameters with one of them set, or why it can not be."""
    changed = _with(params, command.name.split("."), command)
    if isinstance(changed, str):
        return changed
    return next((wrong for wrong in (*check_limits(changed), *check_arm(changed))), changed)


def _done(now: Situation, command: SetTilt | SetParam, evr: ParamSet | TiltSet) -> Situation:
    return told(now, CommandAccepted(name_of(command)), evr, CommandCompleted(name_of(command)))


def _with(record: Any, names: list[str], command: SetParam) -> Params | str:
    """The record with the number at this place replaced, or why not."""
    name, *rest = names
    known = [field.name for field in fields(record)]
    if name not in known:
        return f"{command.name}: {name!r} is not a parameter; there are {', '.join(known)}"
    value = getattr(record, name)
    if rest and is_dataclass(value):
        inner = _with(value, rest, command)
        return inner if isinstance(inner, str) else replace(record, **{name: inner})
    if rest or not isinstance(value, int | float):
        return f"{command.name}: not one number; only single numbers can be set"
    if isinstance(value, int) and command.value != int(command.value if isfinite(command.value) else 0):
        return f"{command.name}: must be a whole number, is {command.value}"
    number = int(command.value) if isinstance(value, int) else float(command.value)
    changed: Params = replace(record, **{name: number})
    return changed
