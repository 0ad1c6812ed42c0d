"""Paths of motor set-points over time: joint moves, lines over knots, holds and stops.

Paths are immutable.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from ruckig import InputParameter, Result, Ruckig, Trajectory

from fsw.config import CYCLE_S, Config
from fsw.dictionary.types import cycle_record
from fsw.kinematics.chain import forward, joint_jacobian, tool_pose
from fsw.kinematics.transforms import Array, norm

SPEED_SAMPLES: Final = np.linspace(0.0, 1.0, 9)
"""Shares of a joint move at which the tool speed is computed."""


@cycle_record
class Setpoint:
    """Commanded motor angles and rates on the output side, (5,)."""

    motor_rad: Array
    rate_rad_s: Array

    def at_rest(self) -> "Setpoint":
        """Return the same angles, at rest."""
        return Setpoint(self.motor_rad, np.zeros_like(self.rate_rad_s))


@dataclass(frozen=True, slots=True)
class TrajectoryRequest:
    """Start and end at rest, and bounds, of each degree of freedom."""

    start: tuple[float, ...]
    end: tuple[float, ...]
    speed: tuple[float, ...]
    acceleration: tuple[float, ...]
    jerk: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class JerkLimited:
    """Jerk-limited trajectory; it is copied and written as the request that it was computed from."""

    request: TrajectoryRequest
    trajectory: Trajectory

    def __reduce__(self) -> tuple[Callable[[TrajectoryRequest], "JerkLimited"], tuple[TrajectoryRequest]]:
        return plan_trajectory, (self.request,)


@dataclass(frozen=True, slots=True, eq=False)
class JointPath:
    """Jerk-limited move of all joints, which start and end together, at rest."""

    duration_s: float
    trajectory: JerkLimited

    def at(self, time_s: float) -> Setpoint:
        """Compute the set-point at a time from the start; after the end, the last one."""
        position, velocity, _ = self.trajectory.trajectory.at_time(min(time_s, self.duration_s))
        return Setpoint(np.array(position), np.array(velocity))


@dataclass(frozen=True, slots=True)
class Travel:
    """Length of a path over knots and its bounds, in metres of a line or newtons of a preload."""

    length: float
    speed: float
    acceleration: float
    jerk: float


@dataclass(frozen=True, slots=True, eq=False)
class LinePath:
    """Jerk-limited travel over equally spaced knots; cubics join the knots."""

    duration_s: float
    travel: JerkLimited
    step: float
    """Travel from one knot to the next, in the unit of its Travel."""
    coefficients: Array
    """Cubic of each segment in u = (s - s_k) / step, highest power first, (segments, 4, 5)."""

    def at(self, time_s: float) -> Setpoint:
        """Compute the set-point at a time from the start; after the end, the last one."""
        s, speed = self.travel_at(time_s)
        u = s / self.step
        k = min(int(u), len(self.coefficients) - 1)
        u -= k
        a, b, c, d = self.coefficients[k]
        rate = ((3 * u * a + 2 * b) * u + c) * (speed / self.step)
        return Setpoint(((a * u + b) * u + c) * u + d, rate)

    def travel_at(self, time_s: float) -> tuple[float, float]:
        """Compute travel and speed at a time from the start."""
        position, velocity, _ = self.travel.trajectory.at_time(min(time_s, self.duration_s))
        return position[0], velocity[0]


@dataclass(frozen=True, slots=True, eq=False)
class HoldPath:
    """Path on which no joint moves."""

    duration_s: float
    motor_rad: Array

    def at(self, time_s: float) -> Setpoint:
        """Return the set-point, the same at any time."""
        return Setpoint(self.motor_rad, np.zeros_like(self.motor_rad))


@dataclass(frozen=True, slots=True, eq=False)
class StopPath:
    """Stop with constant deceleration; all joints come to rest together."""

    duration_s: float
    start: Setpoint

    def at(self, time_s: float) -> Setpoint:
        """Compute the set-point at a time from the start; after the end, the last one."""
        t = min(time_s, self.duration_s)
        remaining = 1 - t / self.duration_s
        return Setpoint(
            self.start.motor_rad + self.start.rate_rad_s * (t * (1 + remaining) / 2),
            self.start.rate_rad_s * remaining,
        )


Path = JointPath | LinePath | HoldPath | StopPath


def joint_path(config: Config, start_rad: Array, end_rad: Array) -> JointPath:
    """Compute the fastest jerk-limited move within bounds of joints and tools, by motor angles, (5,) each."""
    speed_rad_s = config.speed_rad_s * _speed_share(config, start_rad, end_rad)
    planned = plan_trajectory(
        _request(start_rad, end_rad, speed_rad_s, config.acceleration_rad_s2, config.jerk_rad_s3)
    )
    return JointPath(planned.trajectory.duration, planned)


def _speed_share(config: Config, start_rad: Array, end_rad: Array) -> float:
    """Compute the share of the joint speeds at which no tool is too fast.

    The tool that is farthest from the turret axis counts. Its speed is sampled along a move with all joints
    at constant rates.
    """
    turn_rad = end_rad - start_rad
    longest_s = float(np.max(np.abs(turn_rad) / config.speed_rad_s))
    if longest_s < CYCLE_S:
        return 1.0
    poses = start_rad[:, None] + turn_rad[:, None] * SPEED_SAMPLES
    frames = forward(config.arm, poses)
    J = joint_jacobian(frames, tool_pose(config.arm, frames, config.farthest_tool).p)[3:]
    fastest = float(norm(np.einsum("ijk,j->ik", J, turn_rad / longest_s)).max())
    return min(1.0, config.params.motion.tool_speed_m_s / fastest)


def line_path(config: Config, knots_rad: Array, travel: Travel) -> LinePath:
    """Compute a path over knots, on which no joint exceeds its speed.

    Args:
        knots_rad: Motor angles at equal steps of the travel, shape (k, 5).
        travel: Length of the path, and bounds of its speed, acceleration and jerk.
    """
    step = travel.length / (len(knots_rad) - 1)
    coefficients = _cubics(knots_rad)
    steepest = np.max(_max_slopes(coefficients) / config.speed_rad_s) / step
    speed = min(travel.speed, 1.0 / max(float(steepest), 1e-9))
    bounds = (np.array([bound]) for bound in (speed, travel.acceleration, travel.jerk))
    planned = plan_trajectory(_request(np.zeros(1), np.array([travel.length]), *bounds))
    return LinePath(planned.trajectory.duration, planned, step, coefficients)


def stop_path(config: Config, start: Setpoint) -> StopPath:
    """Compute the stop from a moving set-point; the slowest joint decides its duration."""
    duration = float(
        np.max(np.abs(start.rate_rad_s) / (config.params.motion.stop_factor * config.acceleration_rad_s2))
    )
    return StopPath(max(duration, CYCLE_S), start)


def plan_trajectory(request: TrajectoryRequest) -> JerkLimited:
    """Compute a trajectory within its bounds."""
    parameters = InputParameter(len(request.start))
    parameters.current_position = list(request.start)
    parameters.target_position = list(request.end)
    parameters.max_velocity = list(request.speed)
    parameters.max_acceleration = list(request.acceleration)
    parameters.max_jerk = list(request.jerk)
    trajectory = Trajectory(len(request.start))
    result = Ruckig(len(request.start)).calculate(parameters, trajectory)
    if result != Result.Working and result != Result.Finished:
        raise ValueError(f"no trajectory for {request}: {result}")
    return JerkLimited(request, trajectory)


def _request(start: Array, end: Array, speed: Array, acceleration: Array, jerk: Array) -> TrajectoryRequest:
    return TrajectoryRequest(*(tuple(one.tolist()) for one in (start, end, speed, acceleration, jerk)))


def _max_slopes(coefficients: Array) -> Array:
    """Compute the largest slope of each joint along the cubics, in rad per step, shape (5,).

    It is at an end of a segment or at the extremum of the slope inside it.
    """
    a, b, c, _ = np.moveaxis(coefficients, 1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = np.clip(np.nan_to_num(-b / (3 * a)), 0.0, 1.0)
    slopes = [np.abs((3 * a * u + 2 * b) * u + c) for u in (np.zeros_like(a), np.ones_like(a), between)]
    steepest: Array = np.max(slopes, axis=(0, 1))
    return steepest


def _cubics(knots: Array) -> Array:
    """Compute Hermite cubics through the knots; slopes are those of parabolas through three knots each."""
    slope = np.gradient(knots, axis=0, edge_order=2 if len(knots) > 2 else 1)
    y0, y1, m0, m1 = knots[:-1], knots[1:], slope[:-1], slope[1:]
    return np.stack([2 * (y0 - y1) + m0 + m1, 3 * (y1 - y0) - 2 * m0 - m1, m0, y0], axis=1)
