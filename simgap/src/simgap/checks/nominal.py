"""The nominal model: a simulation of the logged commands by the model as it is."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from simgap.arrays import Array
from simgap.common.errors import RobotError
from simgap.logs import Motion
from simgap.simulation.compiled import Models
from simgap.simulation.simulation import Engine
from simgap.simulation.windows import Window, cut_windows


@dataclass(frozen=True, slots=True)
class NominalMotion:
    """The nominal model in one motion."""

    motion: str
    position: Mapping[str, Array]
    """Joint -> predicted position at the times of the logged ones, (n,) [rad]; NaN if it blew up, and where
    not all joints have a position."""
    mean_abs_rad: Mapping[str, float]
    """Joint -> mean absolute difference from the logged position; NaN if it blew up, or is not simulated."""


def simulate_nominal(models: Models, motion: Motion) -> NominalMotion:
    """Simulate a motion once, as a diagnosis does, and compare."""
    names = [joint.name for joint in models.robot.joints]
    logged = {name: motion.joints[name].position for name in names}
    predicted = {name: np.full(one.value.size, math.nan) for name, one in logged.items()}
    error = dict.fromkeys(names, math.nan)
    for window in _whole_window(models, motion):
        found = Engine(models, [], [window], 1).positions(np.zeros((1, 0)))[0]
        parts = np.split(found, np.cumsum([one.size for one in window.sample_time_s])[:-1])
        for name, part in zip(names, parts, strict=True):
            first = int(np.searchsorted(logged[name].time_s, window.start_s))
            at = slice(first, first + part.size)
            predicted[name][at] = part
            error[name] = float(np.mean(np.abs(part - logged[name].value[at]))) if part.size else math.nan
    return NominalMotion(motion.name, predicted, error)


def _whole_window(models: Models, motion: Motion) -> list[Window]:
    """Return a motion as one window; none without a gain, without a command, or with too few positions."""
    if not all(joint.knows_gains for joint in models.robot.joints):
        return []
    try:
        return cut_windows(models.robot, motion, None, 0.0)
    except RobotError:
        return []
