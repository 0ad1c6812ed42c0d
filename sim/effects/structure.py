"""Effects on compliance and mass of the links, of the body of the rover and of the turret."""

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import mujoco
import numpy as np

from fsw.dictionary.enums import Frame
from fsw.dictionary.params import Params, PointMass
from fsw.dictionary.types import Vector3, vector3
from fsw.kinematics.transforms import Array
from sim.effects.effect import (
    Compliance,
    EachCycle,
    Effect,
    Factor,
    Hardware,
    ParameterSpec,
    link_of,
    matrix6,
    with_link,
)
from sim.plant import SCREW_AXES as SPRING_AXES
from sim.plant import SPRING_NAMES, Plant
from sim.record import Disturbance

MIN_MASS_KG = 1e-4
"""Mass in place of none: MuJoCo refuses a body without mass."""
_LUMPS_OF = (
    ("arm1",),
    ("link1", "link1_far"),
    ("link2", "link2_far"),
    ("link3", "link3_far"),
    ("link4", "link4_far"),
    ("link5", "turret"),
)


@dataclass(frozen=True, slots=True)
class Creep:
    """Time of the last cycle, and angle by which a link has crept."""

    time_s: float
    angle_rad: float


@dataclass(frozen=True, slots=True)
class LinkStiffness(Effect):
    """Factor on all six stiffnesses of the link that ends in a frame."""

    frame: Frame
    factor: Factor

    def __post_init__(self) -> None:
        _refuse_rigid(self.frame)

    def on_model(self, spec: mujoco.MjSpec) -> None:
        for axis in SPRING_AXES:
            joint = spec.joint(f"{SPRING_NAMES[self.frame]}_{axis}")
            joint.stiffness *= self.factor
            joint.damping *= self.factor

    def on_params(self, params: Params) -> Params:
        """Divide the compliance by the factor."""
        link = link_of(params, self.frame)
        compliance = matrix6(np.array(link.compliance) * (1 / self.factor))
        return with_link(params, self.frame, replace(link, compliance=compliance))


@dataclass(frozen=True, slots=True)
class _AddedCompliance(Effect):
    """Effect that adds compliance about one axis of one spring."""

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Add the compliance in series with the spring."""
        frame, axis, compliance_rad_Nm = self.added_compliance()
        joint = spec.joint(f"{SPRING_NAMES[frame]}_{SPRING_AXES[axis]}")
        softer = 1.0 / (1.0 + compliance_rad_Nm * joint.stiffness[0])
        joint.stiffness *= softer
        joint.damping *= softer

    def on_params(self, params: Params) -> Params:
        frame, axis, compliance_rad_Nm = self.added_compliance()
        link = link_of(params, frame)
        compliance = np.array(link.compliance)
        compliance[axis, axis] += compliance_rad_Nm
        return with_link(params, frame, replace(link, compliance=matrix6(compliance)))

    def added_compliance(self) -> tuple[Frame, int, float]:
        """Return the frame of the spring, the index of its axis, and the added compliance [rad/(N m)]."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class LinkTorsion(_AddedCompliance):
    """Added torsional compliance of the link that ends in a frame, about the x axis of its spring."""

    frame: Frame
    compliance_rad_Nm: Compliance

    def __post_init__(self) -> None:
        _refuse_rigid(self.frame, "rover-compliance")

    def added_compliance(self) -> tuple[Frame, int, float]:
        return self.frame, 0, self.compliance_rad_Nm


@dataclass(frozen=True, slots=True)
class LinkBending(_AddedCompliance):
    """Added bending compliance of a link about an axis of its spring; in link 1, y is pitch, else z."""

    frame: Frame
    axis: Literal["y", "z"]
    compliance_rad_Nm: Compliance

    def __post_init__(self) -> None:
        _refuse_rigid(self.frame, "rover-compliance")

    def added_compliance(self) -> tuple[Frame, int, float]:
        return self.frame, "xyz".index(self.axis), self.compliance_rad_Nm


@dataclass(frozen=True, slots=True)
class LinkCreep(EachCycle):
    """Bending of a link that grows with the time under load, from none at the begin of a run.

    It approaches compliance times load exponentially. In a cycle the spring creeps by its own strain at most:
    farther on, its load would have the other sign, and the arm would swing up from cycle to cycle.
    """

    frame: Frame
    axis: Literal["y", "z"]
    compliance_rad_Nm: Compliance
    time_s: Annotated[float, ParameterSpec(0.1, 1e4, unit="s", typical=5.0)] = 5.0

    def __post_init__(self) -> None:
        _refuse_rigid(self.frame, "rover-compliance")

    def begin(self, plant: Plant, hardware: Hardware) -> Creep:
        return Creep(float(plant.data.time), 0.0)

    def cycle(self, plant: Plant, hardware: Hardware, state: Creep) -> tuple[Creep, Disturbance]:
        now_s, at = float(plant.data.time), plant.at.springs[self.frame]["xyz".index(self.axis)]
        stiffness_Nm_rad = float(plant.model.jnt_stiffness[plant.model.dof_jntid[at]])
        load_Nm = stiffness_Nm_rad * (float(plant.data.qpos[at]) - state.angle_rad)
        share = -float(np.expm1(-max(now_s - state.time_s, 0.0) / self.time_s))
        unloaded = max(share * self.compliance_rad_Nm * stiffness_Nm_rad, 1.0)
        crept_rad = share * (self.compliance_rad_Nm * load_Nm - state.angle_rad) / unloaded
        angle_rad = state.angle_rad + crept_rad
        plant.model.qpos_spring[at] = angle_rad
        return Creep(now_s, angle_rad), Disturbance()


@dataclass(frozen=True, slots=True)
class RoverCompliance(_AddedCompliance):
    """Added compliance of the rover's body under the arm, about an axis of RMECH."""

    axis: Literal["x", "y", "z"]
    compliance_rad_Nm: Compliance

    def added_compliance(self) -> tuple[Frame, int, float]:
        return Frame.ARM1, "xyz".index(self.axis), self.compliance_rad_Nm


@dataclass(frozen=True, slots=True)
class LinkMass(Effect):
    """Factor on the mass of the link that ends in a frame, and shift of its centre in link axes."""

    frame: Frame
    factor: Annotated[float, ParameterSpec(0.1, 10.0, unit="1", typical=0.05, neutral=1.0)]
    shift_m: Annotated[Vector3, ParameterSpec(-0.1, 0.1, unit="m", typical=5e-3, neutral=0.0)] = (
        0.0,
        0.0,
        0.0,
    )

    def __post_init__(self) -> None:
        if self.frame is Frame.TOOL:
            raise ValueError("frame: tool is no link; the mass of the tools is the turret's, arm6")

    def on_model(self, spec: mujoco.MjSpec) -> None:
        for name in _LUMPS_OF[self.frame]:
            body = spec.body(name)
            body.mass *= self.factor
            body.inertia = body.inertia * self.factor
            body.ipos = body.ipos + np.array(self.shift_m)

    def on_params(self, params: Params) -> Params:
        link = link_of(params, self.frame)
        changed = replace(link, near=self._lump(link.near), far=self._lump(link.far))
        return with_link(params, self.frame, changed)

    def _lump(self, lump: PointMass) -> PointMass:
        x, y, z = (c + s for c, s in zip(lump.com_m, self.shift_m, strict=True))
        return PointMass(lump.mass_kg * self.factor, (x, y, z))


def _refuse_rigid(frame: Frame, for_rover: str | None = None) -> None:
    """Refuse a frame without a spring, and the rover's spring if another effect is for it."""
    if frame >= len(SPRING_NAMES):
        known = ", ".join(Frame(k).name.lower() for k in range(len(SPRING_NAMES)))
        raise ValueError(f"frame: {frame.name.lower()} has no spring; there are {known}")
    if frame is Frame.ARM1 and for_rover is not None:
        raise ValueError(f"frame: the spring of arm1 is the rover's; take {for_rover}")


@dataclass(frozen=True, slots=True)
class StandInTurret(Effect):
    """Mass on the turret interface in place of the turret, with the same centre of mass."""

    mass_kg: Annotated[float, ParameterSpec(0.0, 60.0, unit="kg", typical=19.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        _set_mass(spec, self.mass_kg)

    def on_params(self, params: Params) -> Params:
        link = link_of(params, Frame.ARM6)
        return with_link(params, Frame.ARM6, replace(link, far=replace(link.far, mass_kg=self.mass_kg)))


@dataclass(frozen=True, slots=True)
class TurretMass(Effect):
    """Added mass of the turret, with the same centre of mass."""

    extra_kg: Annotated[float, ParameterSpec(-20.0, 20.0, unit="kg", typical=1.0, neutral=0.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        _set_mass(spec, float(spec.body("turret").mass) + self.extra_kg)

    def on_params(self, params: Params) -> Params:
        return _with_turret(params, mass_kg=self.extra_kg)


@dataclass(frozen=True, slots=True)
class TurretCentre(Effect):
    """Shift of the centre of mass of the turret along an axis of frame Arm6."""

    axis: Literal["x", "y", "z"]
    shift_m: Annotated[float, ParameterSpec(-0.1, 0.1, unit="m", typical=5e-3, neutral=0.0)]

    def on_model(self, spec: mujoco.MjSpec) -> None:
        turret = spec.body("turret")
        turret.ipos = turret.ipos + self._shift()

    def on_params(self, params: Params) -> Params:
        return _with_turret(params, shift_m=self._shift())

    def _shift(self) -> Array:
        return np.array([self.shift_m * (self.axis == axis) for axis in "xyz"])


def params_with_stand_in(params: Params, stand_in_kg: float | None) -> Params:
    """Return the flight parameters with a stand-in turret of this mass; None keeps the turret."""
    return params if stand_in_kg is None else StandInTurret(stand_in_kg).on_params(params)


def _set_mass(spec: mujoco.MjSpec, mass_kg: float) -> None:
    turret, mass_kg = spec.body("turret"), max(mass_kg, MIN_MASS_KG)
    turret.inertia = turret.inertia * (mass_kg / turret.mass)
    turret.mass = mass_kg


def _with_turret(params: Params, mass_kg: float = 0.0, shift_m: Array | float = 0.0) -> Params:
    """Return the parameters with a turret of more mass, or with its centre shifted."""
    link = link_of(params, Frame.ARM6)
    centre_m = vector3(np.array(link.far.com_m) + shift_m)
    return with_link(params, Frame.ARM6, replace(link, far=PointMass(link.far.mass_kg + mass_kg, centre_m)))
