"""The world around the arm: which scene, how the rover is tilted, and the rock face to be touched."""

from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Final, Literal

import mujoco
import numpy as np

from fsw.dictionary.params import Params
from fsw.dictionary.types import Vector3
from fsw.kinematics.transforms import Array
from sim.frames import FLIP, P_NR_M, gravity_in_rover
from sim.rock import add_rock, lower_ground

Scene = Literal["mars", "earth"]

MJCF: Final = Path(str(files("sim") / "models" / "mjcf"))
GRAVITY_M_S2: Final = {"mars": 3.711, "earth": 9.81}
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

    scene: Scene = "mars"
    tilt_roll_rad: float = 0.0
    tilt_pitch_rad: float = 0.0
    surface: Surface | None = None

    @property
    def gravity_N_m_s2(self) -> Array:
        """Gravity in RNAV (and RMECH) axes."""
        return gravity_in_rover(self.tilt_roll_rad, self.tilt_pitch_rad, GRAVITY_M_S2[self.scene])

    @property
    def ground_N_m(self) -> float:
        """Height of the ground in RNAV, z down: below a surface that lies low."""
        return 0.0 if self.surface is None else max(0.0, self.surface.p_N_m[2] + BELOW_ROCK_M)

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
    spec = _drawn(world.scene, for_pictures).copy()
    spec.option.gravity = FLIP * world.gravity_N_m_s2
    if world.surface is not None:
        add_rock(spec, np.array(world.surface.p_N_m), np.array(world.surface.normal_N))
        lower_ground(spec, -world.ground_N_m)
        if not for_pictures:
            _leave_out_looks(spec)
    return spec


@cache
def _drawn(scene: Scene, for_pictures: bool) -> mujoco.MjSpec:
    """Read once in a process: what is done to an arm is done to a copy."""
    spec = mujoco.MjSpec.from_file(str(MJCF / f"{scene}.xml"))
    if not for_pictures:
        _leave_out_looks(spec)
    return spec


def _leave_out_looks(spec: mujoco.MjSpec) -> None:
    for geom in list(spec.geoms):
        if geom.contype == 0 and geom.conaffinity == 0:
            spec.delete(geom)


def told_of(world: World, params: Params) -> Params:
    """Flight parameters of this place: the ground is where the rover's cameras see it."""
    ground_z_m = float(world.ground_N_m - P_NR_M[2])
    return replace(params, collision=replace(params.collision, ground_z_m=ground_z_m))


def inside_rover(p_N_m: Vector3) -> bool:
    """Whether a point (RNAV) is inside a collision geom of the rover."""
    spec = mujoco.MjSpec.from_file(str(MJCF / "rover.xml"))
    _leave_out_looks(spec)
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
