"""The world around the arm: which scene, how the rover is tilted, and the rock face to be touched."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import mujoco
import numpy as np

from fsw.dictionary.commands import Vector3
from fsw.kinematics.transforms import Array
from sim.frames import FLIP, gravity_in_rover

MJCF: Final = Path(__file__).resolve().parents[1] / "models" / "mjcf"
GRAVITY_M_S2: Final = {"mars": 3.711, "earth": 9.81}
ROCK_HALF_M: Final = (0.11, 0.09, 0.06)
BELOW_ROCK_M: Final = 0.1
MAX_TILT_RAD: Final = float(np.radians(30.0))
REQUIRED_MUJOCO: Final = "4.0.1"


class WrongMujoco(RuntimeError):
    """Results are bit-identical between runs of one MuJoCo version only."""


@dataclass(frozen=True, slots=True)
class Surface:
    """A plane rock face through a point; the normal points out of the rock. RNAV, metres."""

    p_N_m: Vector3
    normal_N: Vector3


@dataclass(frozen=True, slots=True)
class World:
    """Everything outside the arm."""

    scene: Literal["mars", "earth"] = "mars"
    tilt_roll_rad: float = 0.0
    tilt_pitch_rad: float = 0.0
    surface: Surface | None = None

    @property
    def gravity_N_m_s2(self) -> Array:
        """Gravity in RNAV (and RMECH) axes."""
        return gravity_in_rover(self.tilt_roll_rad, self.tilt_pitch_rad, GRAVITY_M_S2[self.scene])

    @property
    def tilt_rad(self) -> float:
        """Angle between the rover's down axis and gravity."""
        return float(np.arccos(np.clip(np.cos(self.tilt_roll_rad) * np.cos(self.tilt_pitch_rad), -1.0, 1.0)))


def build(world: World, for_pictures: bool = False) -> mujoco.MjSpec:
    """The MuJoCo specification of this world with the nominal arm in it.

    Without `for_pictures`, geoms that only look are left out: they cost time in every step. The state is the
    same, so a run can be drawn with the other model.
    """
    if mujoco.__version__ != REQUIRED_MUJOCO:
        raise WrongMujoco(f"MuJoCo {mujoco.__version__} is installed, {REQUIRED_MUJOCO} is required")
    spec = mujoco.MjSpec.from_file(str(MJCF / f"{world.scene}.xml"))
    spec.option.gravity = FLIP * world.gravity_N_m_s2
    if world.surface is not None:
        _add_rock(spec, world.surface)
        # a target below the wheels: the rover stands on a rise
        spec.geom("ground").pos[2] = min(0.0, -world.surface.p_N_m[2] - BELOW_ROCK_M)
    if not for_pictures:
        for geom in list(spec.geoms):
            if geom.contype == 0 and geom.conaffinity == 0:
                spec.delete(geom)
    return spec


def inside_rover(p_N_m: Vector3) -> bool:
    """Whether a point (RNAV) is inside a collision geom of the rover."""
    spec = mujoco.MjSpec.from_file(str(MJCF / "rover.xml"))
    for geom in list(spec.geoms):
        if geom.contype == 0 and geom.conaffinity == 0:
            spec.delete(geom)
    probe = spec.worldbody.add_geom(name="probe", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(1e-3, 0, 0))
    probe.pos = FLIP * np.array(p_N_m)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    probe_id = model.geom("probe").id
    others = (
        geom
        for geom in range(model.ngeom)
        if geom != probe_id and model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_PLANE
    )
    return any(mujoco.mj_geomDistance(model, data, geom, probe_id, 1.0, None) < 0 for geom in others)


def _add_rock(spec: mujoco.MjSpec, surface: Surface) -> None:
    """A slab whose +z face is the surface, on a heap of rounded rock that only looks."""
    z = FLIP * np.array(surface.normal_N)
    z = z / np.linalg.norm(z)
    x = np.cross([0.0, 1.0, 0.0], z)
    x = np.array([1.0, 0.0, 0.0]) if np.linalg.norm(x) < 1e-6 else x / np.linalg.norm(x)
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.column_stack([x, np.cross(z, x), z]).ravel())
    rock = spec.worldbody.add_body(name="rock", pos=FLIP * np.array(surface.p_N_m), quat=quat)
    rock.add_geom(
        name="rock_face",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=ROCK_HALF_M,
        pos=(0, 0, -ROCK_HALF_M[2]),
        contype=2,
        conaffinity=1,
        rgba=(0.42, 0.27, 0.19, 1),
        solref=(0.01, 1),
    )
    for dx, dy, dz, size in ((0.05, 0.02, -0.09, 0.11), (-0.06, -0.03, -0.1, 0.1), (0.0, 0.03, -0.14, 0.13)):
        rock.add_geom(
            type=mujoco.mjtGeom.mjGEOM_ELLIPSOID,
            size=(size * 1.25, size, 0.75 * size),
            pos=(dx, dy, dz),
            contype=0,
            conaffinity=0,
            group=2,
            rgba=(0.38, 0.24, 0.17, 1),
        )
