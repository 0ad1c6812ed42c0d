"""Effects of the user's own, from a Python file."""

import inspect
import math
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import TypeVar

from simgap.common.errors import RobotError
from simgap.common.modules import load_module
from simgap.effects.effect import BODY_HOOKS, HOOKS, Effect, Family, JointEffect, Size, joint_scales
from simgap.logs import Logs
from simgap.robot import Robot

T = TypeVar("T")


def load_effects(path: str | Path, robot: Robot, logs: Logs) -> tuple[Effect, ...]:
    """Load effects from a Python file, which is executed; RobotError if it fails or holds no complete one.

    If the file has a function `effects(robot, logs)`, it returns the effects. Else each subclass of
    JointEffect in the file is put at each joint that has a log.
    """
    place = str(path)
    module = load_module(Path(path))
    function = getattr(module, "effects", None)

    def make() -> tuple[object, ...]:
        return _everywhere(module, robot, logs) if function is None else tuple(function(robot, logs))

    found = _run(place, "its effects cannot be made", make)
    if not found:
        raise RobotError(
            f"{place}: no effect; give a subclass of JointEffect or a function effects(robot, logs)"
        )
    effects = tuple(_checked(place, one, robot) for one in found)
    keys = [effect.key for effect in effects]
    for key in keys:
        if keys.count(key) > 1:
            raise RobotError(
                f"{place}: {keys.count(key)} effects have the key {key!r}; give each its own name"
            )
    return effects


def _everywhere(module: ModuleType, robot: Robot, logs: Logs) -> tuple[Effect, ...]:
    kinds = [
        kind
        for kind in vars(module).values()
        if inspect.isclass(kind) and issubclass(kind, JointEffect) and kind.__module__ == module.__name__
    ]
    scales = joint_scales(robot, logs.fit)
    return tuple(kind.at(robot, place, scales) for kind in kinds for place in scales)


def _run(place: str, problem: str, job: Callable[[], T]) -> T:
    """Call code of the user; whatever it raises is the user's to read, in one sentence."""
    try:
        return job()
    except (Exception, SystemExit) as error:
        text = " ".join(f"{type(error).__name__}: {error}".split())
        raise RobotError(f"{place}: {problem}, {text}") from error


def _checked(place: str, effect: object, robot: Robot) -> Effect:
    """Return an effect that has a name, a family, sizes, and a hook that can act at its place."""
    if not isinstance(effect, Effect):
        raise RobotError(f"{place}: effects(robot, logs) returned {effect!r}, which is not an Effect")
    kind = type(effect).__name__
    if not isinstance(getattr(effect, "name", None), str) or not isinstance(
        getattr(effect, "family", None), Family
    ):
        raise RobotError(f"{place}: {kind} lacks its name or its family; give both as class variables")
    sizes = _run(place, f"the sizes of {kind} fail", lambda: effect.sizes)
    if not sizes or not all(isinstance(size, Size) for size in sizes):
        raise RobotError(f"{place}: the sizes of {kind} are {sizes!r}; give a tuple with at least one Size")
    for size in sizes:
        numbers = size.low, size.typical, size.high
        if not all(isinstance(one, float | int) for one in numbers):
            raise RobotError(f"{place}: {size!r} of {kind}: low, high and typical have to be numbers")
        is_finite = all(map(math.isfinite, numbers))
        if not (is_finite and size.low <= 0 < size.typical <= size.high):
            raise RobotError(
                f"{place}: {size.name} of {kind} has bounds {size.low:g} to {size.high:g} and the typical "
                f"size {size.typical:g}; right is low <= 0 < typical <= high, all finite"
            )
    if not effect.overrides(*HOOKS):
        raise RobotError(f"{place}: {kind} changes nothing; override one of {', '.join(HOOKS)}")
    joints = [joint.name for joint in robot.joints]
    at_joint = next((hook for hook in HOOKS if hook not in BODY_HOOKS and effect.overrides(hook)), "")
    if at_joint and effect.place not in joints:
        raise RobotError(
            f"{place}: {kind} at {effect.place!r}: {at_joint} acts at a joint; give it one of the places "
            f"{', '.join(joints)}, or override {' or '.join(sorted(BODY_HOOKS))}"
        )
    return effect
