"""Independent search for the way of a tool change: other code than flight software, in MuJoCo's geometry.

The rock is an infinite plane at the true face. The arm retracts straight, turns with even joint rates to the
standoff of the second tool, and goes straight on to the face.
"""

from dataclasses import replace
from typing import Any, Final

import mujoco
import numpy as np

from fsw.config import Config
from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.ik import BranchVerdict, inverse_kinematics
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import Array
from sim.arms import BuiltArm
from sim.frames import FLIP
from sim.plant import Plant
from sim.world import World, build, lower_ground

RETRACTIONS_M: Final = np.arange(0.10, 0.501, 0.05)
SPACING_RAD: Final = 0.02
LINE_POSES: Final = 6
UNCHECKED: Final = {"link2", "link3"}
"""Bodies that may be below the plane: rock is not endless."""


def reaches(config: Config, tool: str, p_R_m: Array, approach_R: Array, gravity: Array) -> bool:
    """Return whether any branch reaches the face with a tool, and 0.1 m in front of it."""
    return bool(_valid_poses(config, tool, p_R_m, approach_R, gravity, 0.1))


def find_clear_way(
    arm: BuiltArm,
    world: World,
    config: Config,
    tools: tuple[str, str],
    start_rad: Array,
    p_R_m: Array,
    approach_R: Array,
) -> str | None:
    """Find a branch and a retraction that are clear by flight software's padding.

    Args:
        arm: Arm with its flight parameters.
        world: World with the face.
        config: Configuration of flight software.
        tools: Touching tool, and the tool that is to touch next.
        start_rad: Outputs in contact, (5,).
        p_R_m: Point of contact in RMECH, (3,).
        approach_R: Unit approach, (3,).

    Returns:
        The branch and the retraction in words, or None.
    """
    plant, gravity = _plant_with_plane(arm, world, config.params.collision.padding_m), world.gravity_N_m_s2
    first, second = tools
    for retraction_m in RETRACTIONS_M:
        back = _follow(config, first, p_R_m, approach_R, gravity, retraction_m, start_rad)
        if back is None or not _is_clear(plant, config, gravity, back, first):
            continue
        for branch, pose in _valid_poses(config, second, p_R_m, approach_R, gravity, retraction_m):
            turn = _between(back[:, -1], pose)
            onward = _follow(config, second, p_R_m, approach_R, gravity, retraction_m, pose, onward=True)
            if onward is None or not _is_clear(plant, config, gravity, turn, None):
                continue
            if _is_clear(plant, config, gravity, onward, second):
                return f"{branch} after {1e3 * retraction_m:.0f} mm"
    return None


def _plant_with_plane(arm: BuiltArm, world: World, padding_m: float) -> Plant:
    """Build a plant whose rock is an infinite plane, and whose contacts begin at the padding."""
    face = world.surface
    assert face is not None
    spec = build(replace(world, surface=None), arm.model)
    lower_ground(spec, -world.ground_N_m)
    z, quat = FLIP * np.array(face.normal_N), np.zeros(4)
    mujoco.mju_quatZ2Vec(quat, z / np.linalg.norm(z))
    spec.worldbody.add_geom(
        name="rock_face",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=(0, 0, 1),
        pos=FLIP * np.array(face.p_N_m),
        quat=quat,
        contype=2,
        conaffinity=1,
    )
    for geom in spec.geoms:
        geom.margin = 0.5 * padding_m
    return Plant(spec.compile())


def _valid_poses(
    config: Config, tool: str, p_R_m: Array, approach_R: Array, gravity: Array, distance_m: float
) -> list[tuple[str, Array]]:
    """Return branches and outputs at a distance from the face from which the face is reached too."""
    distances = np.array([distance_m, 0.0])
    p = p_R_m[:, None] - approach_R[:, None] * distances
    found = inverse_kinematics(config.arm, tool, p, np.tile(approach_R[:, None], 2), gravity)
    valid = np.all(found.verdict == BranchVerdict.VALID, axis=-1)
    return [(BRANCHES[k % len(BRANCHES)], found.output_rad[:, k, 0]) for k in np.flatnonzero(valid)]


def _follow(
    config: Config,
    tool: str,
    p_R_m: Array,
    approach_R: Array,
    gravity: Array,
    distance_m: float,
    near_rad: Array,
    onward: bool = False,
) -> Array | None:
    """Return outputs (5, n) on the line away from the face, or onward to it, from a pose; None if it ends."""
    distances = np.linspace(0.0, distance_m, LINE_POSES)
    poses = [near_rad]
    for away in distances[::-1] if onward else distances:
        found = inverse_kinematics(config.arm, tool, p_R_m - away * approach_R, approach_R, gravity)
        valid = found.verdict == BranchVerdict.VALID
        if not valid.any():
            return None
        far = np.abs(found.output_rad - poses[-1][:, None]).max(axis=0)
        nearest = int(np.where(valid, far, np.inf).argmin())
        if far[nearest] > 0.6:
            return None
        poses.append(found.output_rad[:, nearest])
    return np.array(poses[1:]).T


def _between(start: Array, end: Array) -> Array:
    count = int(np.abs(end - start).max() / SPACING_RAD) + 2
    return start[:, None] + np.linspace(0.0, 1.0, count) * (end - start)[:, None]


def _is_clear(plant: Plant, config: Config, gravity: Array, outputs: Array, touching: str | None) -> bool:
    """Return whether no geoms but those of the touching tool are closer than the padding at these poses."""
    at_rest = settle_output(config.arm, outputs, gravity)
    for output, strain in zip(outputs.T, np.moveaxis(at_rest.strain, -1, 0), strict=True):
        plant.show(output, strain)
        mujoco.mj_collision(plant.model, plant.data)
        if any(_matters(plant, contact, touching) for contact in plant.data.contact):
            return False
    return True


def _matters(plant: Plant, contact: Any, touching: str | None) -> bool:
    """Return whether a close pair of geoms counts; upper arm and forearm may be near the endless plane."""
    model = plant.model
    bodies = {model.body(model.geom_bodyid[geom]).name for geom in contact.geom}
    if touching is not None and touching.lower() in bodies:
        return False
    with_face = "rock_face" in {model.geom(geom).name for geom in contact.geom}
    return not (with_face and bodies & UNCHECKED)
