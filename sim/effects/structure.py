"""Links that are stiffer or heavier than the drawing says."""

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from fsw.dictionary.commands import Vector3
from fsw.dictionary.joints import Frame
from fsw.dictionary.params import LinkParams, Lump, Params
from sim.effects.effect import Effect
from sim.effects.matrices import scaled

_SPRING_OF = ("rover", "link1", "link2", "link3", "link4")
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
    factor: float

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Scale the six joint springs and their damping."""
        for axis in ("tx", "ty", "tz", "rx", "ry", "rz"):
            joint = spec.joint(f"{_SPRING_OF[self.frame]}_{axis}")
            joint.stiffness *= self.factor
            joint.damping *= self.factor

    def on_params(self, params: Params) -> Params:
        """Compliance divided by the factor."""
        link = _link(params, self.frame)
        return _with_link(
            params, self.frame, replace(link, compliance=scaled(link.compliance, 1 / self.factor))
        )


@dataclass(frozen=True, slots=True)
class LinkMass(Effect):
    """The mass of the link that ends in a frame, times a factor, its centre shifted in link axes."""

    frame: Frame
    factor: float
    shift_m: Vector3 = (0.0, 0.0, 0.0)

    def on_model(self, spec: mujoco.MjSpec) -> None:
        """Scale masses and inertias and shift both halves."""
        for name in _LUMPS_OF[self.frame]:
            body = spec.body(name)
            body.mass *= self.factor
            body.inertia = body.inertia * self.factor
            body.ipos = body.ipos + np.array(self.shift_m)

    def on_params(self, params: Params) -> Params:
        """The lumps scaled and shifted likewise."""
        link = _link(params, self.frame)
        changed = replace(link, near=self._lump(link.near), far=self._lump(link.far))
        return _with_link(params, self.frame, changed)

    def _lump(self, lump: Lump) -> Lump:
        x, y, z = (c + s for c, s in zip(lump.com_m, self.shift_m, strict=True))
        return Lump(lump.mass_kg * self.factor, (x, y, z))


def _link(params: Params, frame: Frame) -> LinkParams:
    link: LinkParams = getattr(params.links, frame.name.lower())
    return link


def _with_link(params: Params, frame: Frame, link: LinkParams) -> Params:
    return replace(params, links=replace(params.links, **{frame.name.lower(): link}))
