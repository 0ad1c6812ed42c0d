"""Path collision check: the clearance of the deflected arm to rover, ground and a surface along paths."""

from typing import Final

import numpy as np

from fsw.collision.distance import compute_clearances, judge_clearances, limit_surface
from fsw.collision.geometry import SURFACE, Surface
from fsw.config import Config
from fsw.estimate.gear import bound_gear
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.chain import Frames, forward, tool_pose
from fsw.kinematics.statics import load_arm
from fsw.kinematics.transforms import Array
from fsw.motion.paths import Path

FINE_STEP_M: Final = 0.01
"""Largest motion of any point of the arm between two poses of the fine check."""
COARSE_STEP_M: Final = 0.05
"""The same for the coarse check, which suffices if nothing is near."""
DEFLECTION_CHANGE_M: Final = 0.01
"""Motion that changes of deflection and backlash add between two poses of the coarse check."""
LEAST_POSES: Final = 9
"""Least number of poses that are checked on a path."""
BLOCK: Final = 500
"""Poses of the fine check that are in memory at once: some 4 MB, where a way to the stowed pose has 25 MB."""


def check_paths(
    config: Config,
    joints: JointEstimate,
    paths: tuple[Path, ...],
    padding_m: float,
    touching: str | None = None,
    surface: Surface | None = None,
) -> str | None:
    """Check that the deflected arm stays clear of rover, ground and surface along paths.

    Too close is closer than the padding, or closer than at the start if the start is within the padding.

    Args:
        config: Configuration of flight software.
        joints: Estimate of the joints, of which gravity and backlash are used.
        paths: Paths of the motors, one after the other.
        padding_m: Distance to be kept.
        touching: Tool that is to touch; no distance is required of it.
        surface: Surface of a target; None if there is none.

    Returns:
        The reason for a refusal, or None if the paths are clear.
    """
    motor = sample_paths(config, paths, COARSE_STEP_M)
    coarse = compute_deflected_frames(config, joints, motor)
    if surface is not None:
        surface = limit_surface(config.collision_geometry, coarse, surface)
    near_m = padding_m + 0.5 * COARSE_STEP_M + DEFLECTION_CHANGE_M
    near = compute_clearances(config.collision_geometry, coarse, near_m, touching, surface)
    if not np.isfinite(near).any():
        return None
    violation = judge_clearances(config.collision_geometry, near, padding_m, touching)
    if violation is None:
        motor = sample_paths(config, paths, FINE_STEP_M)
        blocks = np.split(motor, range(BLOCK, motor.shape[1], BLOCK), axis=1)
        frames = (compute_deflected_frames(config, joints, block) for block in blocks)
        found = [
            compute_clearances(config.collision_geometry, f, padding_m, touching, surface) for f in frames
        ]
        near = np.concatenate(found, axis=-1)
        violation = judge_clearances(config.collision_geometry, near, padding_m, touching)
    if violation is None:
        return None
    clear_share = _compute_share(config, motor, violation.first)
    return f"{violation.reason}; {100 * clear_share:.0f} % of the way are clear"


def check_touch(
    config: Config, joints: JointEstimate, paths: tuple[Path, ...], touching: str, normal_R: Array
) -> str | None:
    """Check that a tool touches alone, wherever on a guarded line the surface is.

    Args:
        config: Configuration of flight software.
        joints: Estimate of the joints, of which gravity and backlash are used.
        paths: Paths of the motors on the line, one after the other.
        touching: Tool that is to touch.
        normal_R: Unit normal of the surface, (3,).

    Returns:
        The reason for a refusal, or None if all other parts stay above the surface.
    """
    geometry, padding_m = config.collision_geometry, config.params.collision.padding_m
    frames = compute_deflected_frames(config, joints, sample_paths(config, paths, COARSE_STEP_M))
    surface = Surface(tool_pose(config.arm, frames, touching).p, normal_R)
    height_m = compute_clearances(geometry, frames, padding_m, touching, surface)[:, SURFACE].min(axis=1)
    part = int(height_m.argmin())
    if height_m[part] >= padding_m:
        return None
    title, depth_mm = geometry.titles[geometry.parts[part]], -1e3 * height_m[part]
    where = f"{abs(depth_mm):.0f} mm {'below' if depth_mm > 0 else 'above'}"
    return (
        f"the {title} would be {where} the surface where the {geometry.titles[touching]} touches it, "
        f"at least {1e3 * padding_m:.0f} mm above are to be kept"
    )


def sample_paths(config: Config, paths: tuple[Path, ...], step_m: float) -> Array:
    """Sample motor angles along paths so finely that no point of the arm moves farther than a step.

    Args:
        config: Configuration of flight software.
        paths: Paths of the motors, one after the other.
        step_m: Farthest that a point of the rigid arm may move between two samples.

    Returns:
        Motor angles in radians on the output side, shape (5, n).
    """
    return np.concatenate([_sample_path(config, path, step_m) for path in paths], axis=1)


def _sample_path(config: Config, path: Path, step_m: float) -> Array:
    count = LEAST_POSES
    while True:
        times_s = np.linspace(0.0, path.duration_s, count)
        motor = np.array([path.at(time_s).motor_rad for time_s in times_s]).T
        steps = float(_bound_motion(config, motor).max()) / step_m
        if steps <= 1:
            return motor
        count = int(np.ceil(1.1 * steps * count))


def compute_deflected_frames(config: Config, joints: JointEstimate, motor_rad: Array) -> Frames:
    """Compute the frames of the arm under gravity, with each output on the side that its load decides.

    An output that friction may hold anywhere between the flanks of its gear is assumed in the middle.

    Args:
        config: Configuration of flight software.
        joints: Estimate of the joints, of which gravity and backlash are used.
        motor_rad: Motor angles on the output side, shape (5, n).

    Returns:
        Frames of the links in RMECH, batch (n).
    """
    # one pass is within 0.4 mm of the equilibrium on Mars, 3 mm on Earth; the padding covers that
    _, strain, torque_Nm = load_arm(config.arm, motor_rad, None, joints.gravity_R_m_s2)
    bounds = bound_gear(config, joints.reference.half_backlash_rad, torque_Nm)
    output = motor_rad + 0.5 * (bounds.lowest_rad + bounds.highest_rad)
    return forward(config.arm, output, strain)


def _bound_motion(config: Config, motor_rad: Array) -> Array:
    """Bound how far any point of the arm moves from each pose (5, n) to the next if no joint turns back."""
    moved: Array = config.collision_geometry.lever_m @ np.abs(np.diff(motor_rad, axis=1))
    return moved


def _compute_share(config: Config, motor_rad: Array, pose: int) -> float:
    """Compute the share of the motion that is done before a pose."""
    moved = _bound_motion(config, motor_rad)
    return float(moved[:pose].sum() / max(moved.sum(), 1e-9))
