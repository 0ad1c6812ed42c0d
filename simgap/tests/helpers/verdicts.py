"""Diagnoses made by hand, as a tool would return them."""

from dataclasses import dataclass, replace
from math import nan
from typing import ClassVar

import numpy as np

from simgap.effects.effect import Effect, Family, Size
from simgap.result import Base, Diagnosis, Finding, JointError, Refusal, Remainder


@dataclass(frozen=True, slots=True)
class Rub(Effect):
    """Dry friction, for these tests."""

    place: str
    name: ClassVar[str] = "Coulomb friction"
    family: ClassVar[Family] = Family.FRICTION

    @property
    def sizes(self):
        return (Size("coulomb_Nm", 0.0, 5.0, 0.2),)


FRICTION = Finding(
    place="lift",
    family=Family.FRICTION,
    effect="Coulomb friction",
    size=(0.44,),
    size_names=("coulomb_Nm",),
    interval=((0.41, 0.47),),
    text="0.44 N m",
    share=0.8,
    places=("lift",),
    families=(Family.FRICTION,),
    effects=("lift: Coulomb friction",),
    next_motion="",
)
GAIN = Base("lift", "gain", 17.8, 12.2, (11.9, 12.5), True, 0.9)
ARMATURE = Base("pan", "armature", 0.028, 0.02, (0.0, 0.1), False)
LIFT = JointError("lift", "rad", 0.0255, 0.012, 0.0024, 0.002)
PAN = JointError("pan", "rad", 0.0043, 0.003, 0.002, 0.0018)
REST = Remainder("pan", "slow", 0.0011, "rad", "position", 0.4)


def diagnosis(**changes):
    """Return a diagnosis with one finding, and these fields changed."""
    fields = {"robot": "arm", "kind": "simulation", "seed": 1, "remaining": (), "refused": ()}
    fields |= {"findings": (FRICTION,), "base": (GAIN,), "errors": (PAN, LIFT)}
    fields |= {"fitted_motions": ("a", "b", "c"), "judged_motions": ("d", "e")}
    return Diagnosis(**(fields | {"effects": (Rub("lift"),), "sizes": ((0.44,),)} | changes))


def finding(**changes):
    """Return the finding, with these fields changed."""
    return replace(FRICTION, **changes)


def without_floor(one):
    """Return an error of which no repeat shows the floor."""
    return replace(one, noise_floor=nan)


REFUSED = tuple(Refusal(name, "the command is cut off at -1.034 rad", 40) for name in "pqrst")
FOUND = diagnosis(
    findings=(FRICTION, finding(effects=("lift: gain error", "lift: torque constant"))),
    base=(GAIN, ARMATURE),
    remaining=(REST,),
    refused=REFUSED,
)
"""A diagnosis with something in every part of its page."""


class Drawn:
    """Residual model of two joints in four motions, drawn from a seed; findings remove most of it."""

    kind, units = "simulation", ("rad", "rad")
    joints, motions = ("pan", "lift"), ("d", "e", "f", "g")

    def __init__(self, n=500):
        self.rng = np.random.default_rng(3)
        self.joint_of = np.repeat([0, 1], 4 * n)
        self.motion_of = np.tile(np.repeat(range(4), n), 2)
        self.time_s = np.tile(0.01 * np.arange(n), 8)

    def residuals(self, effects, sizes):
        gone = np.where(sizes.any(axis=1), 0.1, 1.0)[:, None]
        size_rad = 0.02 * (1 + self.motion_of) * np.sin(self.time_s)
        return gone * size_rad + 1e-3 * self.rng.standard_normal(len(size_rad))

    def select(self, motions):
        return self

    def explain(self, name):
        return np.sin(2 * self.time_s) + 0.3 * self.joint_of
