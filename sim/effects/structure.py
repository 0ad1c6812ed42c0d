"""Links and the rover's body that are softer, stiffer or heavier than the drawing says."""

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import mujoco
import numpy as np

from fsw.dictionary.enums import Frame
from fsw.dictionary.params import Params, PointMass
from fsw.dictionary.types import Vector3
from sim.effects.effect import Effect
from sim.effects.matrices import scaled, softened
from sim.effects.size import Compliance, Factor, Size
from sim.effects.told import link_of, with_link
from sim.plant import AXES as SPRING_AXES
from sim.plant import SPRINGS

_LUMPS_OF = (
    ("arm1",),
    ("link1", "link1_far"),
    ("link2", "link2_far"),
    ("link3", "link3_far"),
    ("link4", "link4_far"),
    ("link5", "turret"),
)


@dataclass(frozen=True, slots=True)
class LinkStiffness(Effect):
    """The spring of the link that ends in a frame, all six stiffnesses times a factor."""

    frame: Frame
    factor: Factor

    def __post_init__(self) -> None:
        _refuse_rigid(self.frame)

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Scale the six joint springs and their damping."""
        for axis in SPRING_AXES:
            joint = spec.joint(f"{SPRINGS[self.frame]}_{axis}")
            joint.stiffness *= self.factor
            joint.damping *= self.factor

    def on_params(self, params: Params) -> Params:
        """Compliance divided by the factor."""
        link = link_of(params, self.frame)
        return with_link(
            params, self.frame, replace(link, compliance=scaled(link.compliance, 1 / self.factor))
        )


@dataclass(frozen=True, slots=True)
class _Softer(Effect):
    """An effect that is compliance about one axis of one spring, on top of what it has."""

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """In series with the spring that is there."""
        frame, axis, compliance_rad_Nm = self.where()
        joint = spec.joint(f"{SPRINGS[frame]}_{SPRING_AXES[axis]}")
        softer = 1.0 / (1.0 + compliance_rad_Nm * joint.stiffness[0])
        joint.stiffness *= softer
        joint.damping *= softer

    def on_params(self, params: Params) -> Params:
        """An element of the compliance."""
        frame, axis, compliance_rad_Nm = self.where()
        link = link_of(params, frame)
        changed = replace(link, compliance=softened(link.compliance, axis, compliance_rad_Nm))
        return with_link(params, frame, changed)

    def where(self) -> tuple[Frame, int, float]:
        """Which spring, about which of its axes, by how much."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class LinkTorsion(_Softer):
    """The link that ends in a frame twists more, about the x axis of its spring."""

    frame: Frame
    compliance_rad_Nm: Compliance

    def __post_init__(self) -> None:
        _refuse_rigid(self.frame)
        _refuse_rover(self.frame)

    def where(self) -> tuple[Frame, int, float]:
        """About x."""
        return self.frame, 0, self.compliance_rad_Nm


@dataclass(frozen=True, slots=True)
class LinkBending(_Softer):
    """The link that ends in a frame bends more, about an axis of its spring: in link 1 y is pitch, else z."""

    frame: Frame
    axis: Literal["y", "z"]
    compliance_rad_Nm: Compliance

    def __post_init__(self) -> None:
        _refuse_rigid(self.frame)
        _refuse_rover(self.frame)

    def where(self) -> tuple[Frame, int, float]:
        """About that axis."""
        return self.frame, "xyz".index(self.axis), self.compliance_rad_Nm


@dataclass(frozen=True, slots=True)
class RoverCompliance(_Softer):
    """The rover's body under the arm gives way more, about an axis of RMECH."""

    axis: Literal["x", "y", "z"]
    compliance_rad_Nm: Compliance

    def where(self) -> tuple[Frame, int, float]:
        """The first spring."""
        return Frame.ARM1, "xyz".index(self.axis), self.compliance_rad_Nm


@dataclass(frozen=True, slots=True)
class LinkMass(Effect):
    """The mass of the link that ends in a frame, times a factor, its centre shifted in link axes."""

    frame: Frame
    factor: Annotated[float, Size(0.1, 10.0, unit="1", typical=0.05, neutral=1.0)]
    shift_m: Annotated[Vector3, Size(-0.1, 0.1, unit="m", typical=5e-3, neutral=0.0)] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if self.frame is Frame.TOOL:
            raise ValueError("frame: tool is no link; the mass of the tools is the turret's, arm6")

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Scale masses and inertias and shift both halves."""
        for name in _LUMPS_OF[self.frame]:
            body = spec.body(name)
            body.mass *= self.factor
            body.inertia = body.inertia * self.factor
            body.ipos = body.ipos + np.array(self.shift_m)

    def on_params(self, params: Params) -> Params:
        """The lumps scaled and shifted likewise."""
        link = link_of(params, self.frame)
        changed = replace(link, near=self._lump(link.near), far=self._lump(link.far))
        return with_link(params, self.frame, changed)

    def _lump(self, lump: PointMass) -> PointMass:
        x, y, z = (c + s for c, s in zip(lump.com_m, self.shift_m, strict=True))
        return PointMass(lump.mass_kg * self.factor, (x, y, z))


def _refuse_rigid(frame: Frame) -> None:
    if frame >= len(SPRINGS):
        known = ", ".join(Frame(k).name.lower() for k in range(len(SPRINGS)))
        raise ValueError(f"frame: {frame.name.lower()} has no spring; there are {known}")


def _refuse_rover(frame: Frame) -> None:
    if frame is Frame.ARM1:
        raise ValueError("frame: the spring of arm1 is the rover's; take rover-compliance")
