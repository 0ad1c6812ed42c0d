"""Checks that the deflected arm stays clear of rover, ground and a surface on its way.

A check walks along the paths and looks at some poses in each piece of its work. If the clearances of two
poses are d1 and d2, and no point of the arm moves farther than m from one to the other, the clearance in
between is at least (d1 + d2 - m) / 2. Where this is not enough, the poses follow each other closely.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from fsw.collision.distance import (
    Clearances,
    PathClearance,
    begin_clearance,
    compute_clearances,
    compute_surface_heights,
    describe_violation,
    follow_clearance,
    limit_surface,
    measure_motion,
)
from fsw.collision.geometry import TargetSurface
from fsw.config import Config
from fsw.dictionary.types import cycle_record
from fsw.estimate.gear import bound_gear
from fsw.estimate.joints import JointEstimate
from fsw.kinematics.chain import Frames, forward, tool_pose
from fsw.kinematics.statics import load_arm
from fsw.kinematics.transforms import Array
from fsw.motion.paths import Path
from fsw.motion.work import Work

FINE_STEP_M: Final = 0.01
"""Motion of any point of the arm between two poses that are close to each other: nothing is missed."""
LONG_STEP_RAD: Final = 0.15
"""Longest step from a pose to the next one: the turns of all joints together.

On its way a point 2.6 m from the shoulder is then at most 2.6 m * 0.15^2 / 8 = 7 mm beside the straight line.
"""
FIRST_STEP_RAD: Final = 0.03
"""First step, before any clearance is known."""
SWAY_M: Final = 0.015
"""Motion off the straight line from pose to pose: 7 mm by the turns, and 7 mm by backlash that is crossed."""
SWAY_SHARE: Final = 0.05
"""Motion that changes of deflection add, as a share of the way.

The deflection changes by 30 mm over a turn of a radian, with which a tool moves by one or two metres.
"""
NEAR_M: Final = 0.05
"""Clearance beyond the padding up to which distances are computed exactly; others are bounded from below."""
LEAST_STEPS: Final = 8
"""Least number of steps along a path, on which a joint may turn back."""
POSES: Final = 24
"""Most poses in a piece of work; each takes some 25 us."""
PAIRS: Final = 200
"""Most pairs of shapes in a piece of work whose distance is computed exactly; each takes some 2.5 us."""
SHORTEST_S: Final = 1e-3
"""Shortest step: a path is continuous, and no joint turns far in this time."""
SHORTER: Final = 0.8
"""Share of the step of the right length that is tried next, as the arm may be faster there."""
LONGER: Final = 2.0
"""Largest factor from the time of a step to that of the next one."""


@cycle_record
class PathWalk:
    """Place that a check has reached on its way along paths."""

    paths: tuple[Path, ...]
    """Paths that are left; the first of them is being followed."""
    motor_rad: Array
    """Motor angles of the last pose, (5,)."""
    time_s: float = 0.0
    """Time of this pose on the first path."""
    step_s: float = np.inf
    """Time to the next pose."""


def begin_walk(paths: tuple[Path, ...]) -> PathWalk:
    """Begin at the start of the first path."""
    return PathWalk(paths, paths[0].at(0.0).motor_rad)


def walk_on(walk: PathWalk, step_rad: float) -> tuple[PathWalk, ...]:
    """Walk to the next poses; all joints together turn by at most a step from each to the next.

    A step that turns out too long is made again with a shorter one.
    """
    places: list[PathWalk] = []
    for _ in range(POSES):
        if not walk.paths:
            break
        path = walk.paths[0]
        step_s = min(walk.step_s, path.duration_s / LEAST_STEPS)
        time_s = min(walk.time_s + step_s, path.duration_s)
        motor_rad = path.at(time_s).motor_rad
        turn_rad = float(np.abs(motor_rad - walk.motor_rad).sum())
        right = SHORTER * step_rad / max(turn_rad, 1e-9)
        if turn_rad > step_rad and step_s > SHORTEST_S:
            walk = replace(walk, step_s=right * step_s)
            continue
        is_end = time_s >= path.duration_s
        walk = PathWalk(
            paths=walk.paths[1:] if is_end else walk.paths,
            motor_rad=motor_rad,
            time_s=0.0 if is_end else time_s,
            step_s=np.inf if is_end else min(right, LONGER) * step_s,
        )
        places.append(walk)
    return tuple(places)


@cycle_record
class PathCheck(Work[str | None]):
    """Check that the arm stays clear along paths; the result is the reason for a refusal, or None.

    A tool that is to touch is not checked. Too close is closer than the padding, or closer than at the start
    if the start is within the padding.
    """

    joints: JointEstimate
    padding_m: float
    touching: str | None
    surface: TargetSurface | None
    walk: PathWalk
    """Place of the last pose up to which the way is known to be clear, or known to be blocked."""
    step_rad: float = FIRST_STEP_RAD
    """Step to the next poses."""
    clearance: PathClearance | None = None
    """Clearance so far; None before the first poses."""
    way_m: float = 0.0
    """Way of the fastest points of the arm so far."""
    clear_m: float = 0.0
    """Way up to the first pose that is too close."""

    def advance(self, config: Config) -> "PathCheck | str | None":
        """Look at the next poses, and judge after the last one."""
        geometry, surface = config.collision_geometry, self.surface
        places = (self.walk, *walk_on(self.walk, self.step_rad))
        motor = np.stack([place.motor_rad for place in places], axis=1)
        frames = compute_deflected_frames(config, self.joints, motor)
        if surface is not None and self.clearance is None:
            surface = limit_surface(geometry, frames, surface)
        within_m = self.padding_m + NEAR_M
        found = compute_clearances(geometry, frames, within_m, self.touching, surface, PAIRS)
        last = self.clearance or begin_clearance(found.near_m[..., 0], self.padding_m, self.touching)
        margin_m = self._margins_m(found, last)
        moved_m = measure_motion(geometry, frames)[: margin_m.size - 1]
        known = moved_m.size if last.violation else _count_known(moved_m, margin_m)
        now = follow_clearance(last, found.near_m[..., : known + 1])
        way_m = self.way_m + np.concatenate([[0.0], np.cumsum(moved_m[:known])])
        clear_m = self.clear_m
        if now.violation is not None and last.violation is None:
            clear_m = float(way_m[now.violation[2] - last.poses])
        after = replace(
            self,
            surface=surface,
            walk=places[known],
            step_rad=self._choose_step(motor, moved_m, margin_m, known, now),
            clearance=now,
            way_m=float(way_m[-1]),
            clear_m=clear_m,
        )
        return after if after.walk.paths else after._judge(config, now)

    def _choose_step(
        self, motor: Array, moved_m: Array, margin_m: Array, known: int, now: PathClearance
    ) -> float:
        """Choose the step to the next poses by the margin at the last known pose.

        After a pose that is too close only the least distance is still asked for.
        """
        if now.violation is not None:
            return LONG_STEP_RAD
        turn_rad = np.abs(np.diff(motor[:, : margin_m.size])).sum(axis=0)
        nearby = slice(max(known - 2, 0), known + 1)
        m_rad = float((moved_m / np.maximum(turn_rad, 1e-9))[nearby].max())
        least_rad = SHORTER * FINE_STEP_M / max(m_rad, 1e-9)
        right_rad = (float(margin_m[known]) - SWAY_M) / max(m_rad, 1e-9)
        if known == 0:
            right_rad = min(right_rad, 0.5 * self.step_rad)
        return min(max(right_rad, least_rad), LONG_STEP_RAD)

    def _margins_m(self, found: Clearances, kept: PathClearance) -> Array:
        """Compute the least distance in each pose beyond what is to be kept, (n,) [m]."""
        near_m: Array = (found.near_m - kept.least_m[..., None]).min(axis=(0, 1))
        margin_m: Array = np.minimum(near_m, found.beyond_m - self.padding_m)
        return margin_m

    def _judge(self, config: Config, clearance: PathClearance) -> str | None:
        violation = describe_violation(config.collision_geometry, clearance)
        if violation is None:
            return None
        clear_share = self.clear_m / max(self.way_m, 1e-9)
        return f"{violation.reason}; {100 * clear_share:.0f} % of the way are clear"


def _count_known(moved_m: Array, margin_m: Array) -> int:
    """Count the steps on which the arm stays clear, or which are short, before the first other one.

    Args:
        moved_m: Motion from pose to pose, shape (n,).
        margin_m: Distances of the poses beyond what is to be kept, shape (n + 1,).
    """
    both_m = margin_m[:-1] + margin_m[1:]
    is_known = (moved_m <= FINE_STEP_M) | (both_m >= moved_m + 2 * (SWAY_M + SWAY_SHARE * moved_m))
    return moved_m.size if is_known.all() else int(is_known.argmin())


def check_paths(
    joints: JointEstimate,
    paths: tuple[Path, ...],
    padding_m: float,
    touching: str | None = None,
    surface: TargetSurface | None = None,
) -> PathCheck:
    """Begin the check of the deflected arm along paths, against rover, ground and surface."""
    return PathCheck(joints, padding_m, touching, surface, begin_walk(paths))


@cycle_record
class TouchCheck(Work[str | None]):
    """Check that a tool touches alone; the result is the reason for a refusal, or None.

    Wherever on a guarded line the surface is, all other parts stay above it.
    """

    joints: JointEstimate
    touching: str
    normal_R: Array
    """Unit normal of the surface, (3,)."""
    walk: PathWalk
    height_m: Array
    """Least height of each part above the surface so far, (parts,)."""

    def advance(self, config: Config) -> "TouchCheck | str | None":
        """Look at the next poses, and judge after the last one."""
        places = (self.walk, *walk_on(self.walk, LONG_STEP_RAD))
        motor = np.stack([place.motor_rad for place in places], axis=1)
        frames = compute_deflected_frames(config, self.joints, motor)
        geometry = config.collision_geometry
        surface = TargetSurface(tool_pose(config.arm, frames, self.touching).p, self.normal_R)
        height_m = compute_surface_heights(geometry, frames, surface, self.touching)
        height_m = np.minimum(self.height_m, height_m)
        after = replace(self, walk=places[-1], height_m=height_m)
        return after if after.walk.paths else after._judge(config)

    def _judge(self, config: Config) -> str | None:
        geometry, padding_m = config.collision_geometry, config.params.collision.padding_m
        part = int(self.height_m.argmin())
        if self.height_m[part] >= padding_m:
            return None
        title, depth_mm = geometry.titles[geometry.parts[part]], -1e3 * self.height_m[part]
        where = f"{abs(depth_mm):.0f} mm {'below' if depth_mm > 0 else 'above'}"
        return (
            f"the {title} would be {where} the surface where the {geometry.titles[self.touching]} touches "
            f"it, at least {1e3 * padding_m:.0f} mm above are to be kept"
        )


def check_touch(
    config: Config, joints: JointEstimate, paths: tuple[Path, ...], touching: str, normal_R: Array
) -> TouchCheck:
    """Begin the check that a tool touches alone along paths, above a surface of a unit normal, (3,)."""
    height_m = np.full(len(config.collision_geometry.parts), np.inf)
    return TouchCheck(joints, touching, normal_R, begin_walk(paths), height_m)


def compute_deflected_frames(config: Config, joints: JointEstimate, motor_rad: Array) -> Frames:
    """Compute the frames of the arm under gravity, with each output on the side that its load decides.

    An output that friction may hold anywhere between the flanks of its gear is assumed in the middle.
    """
    # one pass is within 0.4 mm of the equilibrium on Mars, 3 mm on Earth; the padding covers that
    _, strain, torque_Nm = load_arm(config.arm, motor_rad, None, joints.gravity_R_m_s2)
    bounds = bound_gear(config, joints.reference.half_backlash_rad, torque_Nm)
    output = motor_rad + 0.5 * (bounds.lowest_rad + bounds.highest_rad)
    return forward(config.arm, output, strain)
