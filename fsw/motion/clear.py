"""Whether the arm stays clear of rover and ground all along the paths of a plan."""

from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.joints import Tool
from fsw.estimate.gear import bounds_under
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.chain import Frames, forward
from fsw.kinematics.statics import rest
from fsw.kinematics.transforms import Array
from fsw.motion.paths import Path
from fsw.protect.collision import clearances, too_close

STEP_M: Final = 0.01
"""No point of the arm moves farther between two poses that are looked at."""
COARSE_M: Final = 0.05
"""In a first look, which suffices where nothing is near."""
SWAY_M: Final = 0.01
"""What changes of deflection and backlash add between two poses of the first look."""
FEWEST: Final = 9
"""Poses that are looked at on any path."""


def blocked(
    config: Config,
    joints: JointEstimate,
    paths: tuple[Path, ...],
    padding_m: float,
    touching: Tool | None = None,
) -> str | None:
    """What the arm comes too close to along paths, as it hangs, or None; a tool that is to touch may.

    Too close is closer than the padding, or closer than where the paths begin if that is within it.
    """
    coarse = hanging(config, joints, samples(config, paths, COARSE_M))
    near_m = padding_m + 0.5 * COARSE_M + SWAY_M
    if not np.isfinite(clearances(config.space, coarse, near_m, touching)).any():
        return None
    motor = samples(config, paths, STEP_M)
    close = too_close(config.space, hanging(config, joints, motor), padding_m, touching)
    if close is None:
        return None
    return f"{close.reason}; {100 * _share(config, motor, close.first):.0f} % of the way are clear"


def samples(config: Config, paths: tuple[Path, ...], step_m: float) -> Array:
    """Motor angles (5, n) along paths, so close that no point of the arm moves farther than a step."""
    return np.concatenate([_along(config, path, step_m) for path in paths], axis=1)


def _along(config: Config, path: Path, step_m: float) -> Array:
    count = FEWEST
    while True:
        times = np.linspace(0.0, path.duration_s, count)
        motor = np.array([path.at(time_s).motor_rad for time_s in times]).T
        steps = float(_farthest(config, motor).max()) / step_m
        if steps <= 1:
            return motor
        count = int(np.ceil(1.1 * steps * count))


def hanging(config: Config, joints: JointEstimate, motor_rad: Array) -> Frames:
    """The arm with its motors at these angles (5, n), outputs where their loads press them.

    Where friction may hold an output anywhere in its gear it is taken to be in the middle.
    """
    gravity = joints.gravity_R_m_s2
    hung = rest(config.arm, motor_rad, gravity)
    bounds = bounds_under(config, joints.reference.half_gap_rad, hung.torque_Nm)
    output = motor_rad + 0.5 * (bounds.lowest_rad + bounds.highest_rad)
    return forward(config.arm, output, hung.strain)


def _farthest(config: Config, motor_rad: Array) -> Array:
    """How far any point of the arm moves at most from each pose (5, n) to the next, no joint turning back."""
    moved: Array = config.space.lever_m @ np.abs(np.diff(motor_rad, axis=1))
    return moved


def _share(config: Config, motor_rad: Array, pose: int) -> float:
    """The part of the way that lies before a pose."""
    moved = _farthest(config, motor_rad)
    return float(moved[:pose].sum() / max(moved.sum(), 1e-9))
