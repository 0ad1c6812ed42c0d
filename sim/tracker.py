"""Laser tracker, its targets, and its simulated measurements."""

from dataclasses import dataclass
from typing import Final

import mujoco
import numpy as np

from fsw.kinematics.transforms import IDENTITY, Array, Flags, Pose, rotation_z, screw_exp
from sim.frames import FLIP, P_NR_M
from sim.plant import Plant

VISIBLE_CONE_RAD: Final = float(np.radians(75.0))
"""Assumed largest angle from its axis at which a nest does not hide its ball."""
NEST_OFFSET_M: Final = 0.02
"""Distance of a ball from the surface that carries its nest."""
TRACKER_CLEARANCE_M: Final = 0.05
"""Distance from the tracker below which rays are not checked."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackerTargets:
    """Nests on one body B, at known positions."""

    p_BoQ_B_m: Array
    """Positions, shape (3, k)."""
    axis_B: Array
    """Unit vectors out of the surface, shape (3, k)."""


@dataclass(frozen=True, slots=True)
class Tracker:
    """Pose of a tracker in the ground frame, and its noise in each coordinate, one sigma; typical values."""

    p_GoWo_G_m: tuple[float, float, float] = (4.6, -1.6, -1.7)
    yaw_rad: float = 2.6
    sigma_m: float = 15e-6
    sigma_per_m: float = 6e-6

    @property
    def X_GW(self) -> Pose:
        """Return the pose in the ground frame of the tracker frame W, in which it measures."""
        return Pose(rotation_z(np.array(self.yaw_rad)), np.array(self.p_GoWo_G_m))

    def noise_m(self, distance_m: Array) -> Array:
        """Return one sigma of each coordinate at these distances, shape (...)."""
        return self.sigma_m + self.sigma_per_m * distance_m


TYPICAL_TRACKER: Final = Tracker()


def _make_targets(*nests: tuple[float, float, float, float, float, float]) -> TrackerTargets:
    table = np.array(nests).T
    axis = table[3:] / np.linalg.norm(table[3:], axis=0)
    return TrackerTargets(table[:3] + NEST_OFFSET_M * axis, axis)


GROUND_TARGETS: Final = _make_targets(
    (3.4, -2.6, 0.0, 0.3, 0.3, -1.0),
    (3.6, 1.6, 0.0, 0.3, -0.6, -1.0),
    (0.6, -2.4, 0.0, 1.0, 0.3, -0.6),
    (2.2, 2.2, 0.0, 0.5, -1.0, -0.7),
    (4.2, 0.4, 0.0, 0.2, -0.8, -1.0),
    (1.4, -2.8, -0.5, 1.0, 0.5, -0.4),
)
"""Targets in the ground frame, which is RNAV of a level rover at rest."""
ROVER_TARGETS: Final = _make_targets(
    (0.87, -0.58, -1.28, 1.0, -0.2, -0.3),
    (0.87, 0.58, -1.28, 1.0, -0.2, -0.3),
    (0.60, -0.62, -1.45, 1.0, -0.5, -0.3),
    (0.87, 0.10, -1.35, 1.0, -0.2, -0.3),
    (0.30, 0.55, -1.55, 1.0, -0.5, -0.3),
    (1.10, -1.00, -0.60, 1.0, -0.4, -0.3),
    (1.10, 1.00, -0.60, 1.0, -0.6, -0.3),
    (0.20, -1.00, -1.05, 1.0, -0.6, -0.3),
)
"""Targets in RNAV, on masts that the arm seldom hides."""


def _turret_rings() -> TrackerTargets:
    """Make rings of nests about the axis of the turret, in Arm6; the farthest faces away from the arm."""
    nests = []
    for height_m, radius_m, first, up in (
        (-0.30, 0.16, 0.0, -2.0),
        (-0.20, 0.26, 0.5, -0.5),
        (-0.05, 0.28, 0.0, 0.0),
        (0.02, 0.22, 0.5, 1.0),
    ):
        for k in range(6):
            angle = 2 * np.pi * (k + first) / 6
            x, y = np.cos(angle), np.sin(angle)
            nests.append((radius_m * x, radius_m * y, height_m, x, y, up))
    return _make_targets(*nests)


TURRET_TARGETS: Final = _turret_rings()
"""Targets on the stand-in turret, an open frame, which does not hide them."""


@dataclass(frozen=True, slots=True, eq=False)
class TargetReadings:
    """Measurements of the targets on one body."""

    p_WoQ_W_m: Array
    """Positions, shape (3, k); NaN for hidden targets."""
    sigma_m: Array
    """One sigma of each coordinate, shape (k,)."""

    @property
    def visible(self) -> Flags:
        """Return which targets were measured, shape (k,)."""
        return np.asarray(np.isfinite(self.p_WoQ_W_m[0]))


def rover_pose(roll_rad: float, sway: Array) -> Pose:
    """Compute X_GN, of RNAV in the ground frame, from a roll, right side down, and a screw (6,) [rad, m]."""
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    tilted = Pose(np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]]), np.zeros(3))
    return tilted @ screw_exp(sway)


def turret_pose(plant: Plant) -> Pose:
    """Return X_RF, the pose in RMECH of frame Arm6, the interface of the turret.

    The kinematics of the plant must be up to date.
    """
    body = plant.model.body("turret").id
    p_N = FLIP * plant.data.xpos[body]
    return Pose(FLIP[:, None] * plant.data.xmat[body].reshape(3, 3), p_N - P_NR_M)


def measure_targets(
    tracker: Tracker, plant: Plant, X_GN: Pose, X_RF: Pose, rng: np.random.Generator
) -> tuple[TargetReadings, TargetReadings, TargetReadings]:
    """Measure every visible target on ground, rover and turret once.

    Noise is drawn for hidden targets too, so that what hides them changes no other reading.
    """
    X_GF = X_GN @ Pose(np.eye(3), P_NR_M) @ X_RF
    return (
        _measure_body(tracker, plant, X_GN, GROUND_TARGETS, IDENTITY, rng),
        _measure_body(tracker, plant, X_GN, ROVER_TARGETS, X_GN, rng),
        _measure_body(tracker, plant, X_GN, TURRET_TARGETS, X_GF, rng),
    )


def _measure_body(
    tracker: Tracker, plant: Plant, X_GN: Pose, targets: TrackerTargets, X_GB: Pose, rng: np.random.Generator
) -> TargetReadings:
    p_G = X_GB.R @ targets.p_BoQ_B_m + X_GB.p[:, None]
    to_tracker = np.array(tracker.p_GoWo_G_m)[:, None] - p_G
    distance = np.linalg.norm(to_tracker, axis=0)
    facing = np.einsum("ik,ik->k", X_GB.R @ targets.axis_B, to_tracker / distance) > np.cos(VISIBLE_CONE_RAD)
    clear = np.array([_is_unobstructed(plant, X_GN, p, w) for p, w in zip(p_G.T, to_tracker.T, strict=True)])
    sigma = tracker.noise_m(distance)
    noisy = p_G + sigma * rng.standard_normal(p_G.shape)
    X_GW = tracker.X_GW
    p_W = X_GW.R.T @ (noisy - X_GW.p[:, None])
    return TargetReadings(np.where(facing & clear, p_W, np.nan), sigma)


def _is_unobstructed(plant: Plant, X_GN: Pose, p_G: Array, way_G: Array) -> bool:
    """Return whether only turret and floor lie on the line, shape (3,), from a point to the tracker."""
    model, data = plant.model, plant.data
    start = FLIP * (X_GN.R.T @ (p_G - X_GN.p))
    along = FLIP * (X_GN.R.T @ way_G)
    length = float(np.linalg.norm(along))
    along, travelled, hit = along / length, 0.0, np.zeros(1, np.int32)
    while True:
        step = mujoco.mj_ray(model, data, start + travelled * along, along, None, 1, -1, hit)
        if step < 0 or travelled + step > length - TRACKER_CLEARANCE_M:
            return True
        if not _is_transparent(plant, int(hit[0])):
            return False
        travelled += step + 1e-3


def _is_transparent(plant: Plant, geom: int) -> bool:
    """Return whether a geom does not count: the turret is an open frame, the floor is not as modelled."""
    model = plant.model
    body, turret = int(model.geom_bodyid[geom]), model.body("turret").id
    while body not in (0, turret):
        body = int(model.body_parentid[body])
    return body == turret or bool(model.geom(geom).name == "ground")
