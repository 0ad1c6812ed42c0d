"""Effects that a tracker shows: errors of links and joints of a serial arm, and how they change an arm."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Final

import numpy as np

from simgap.effects.effect import Effect, Family, Size
from simgap.serial_arm.arm import GEOMETRY_NAMES, Link, SerialArm
from simgap.serial_arm.model import (
    COMPLIANCE,
    GEOMETRY,
    HYSTERESIS,
    NON_PERIODIC,
    PERIODIC,
    coefficient_names,
)

MAX_SIZE: Final = 1.0
"""Largest size in radians, metres or rad/(N m): that of an arm file."""
LENGTHS: Final = ("d", "b", "a")


class TrackerEffect(Effect):
    """Effect of one link; its sizes are differences from the arm file, which are 0 where it is absent."""

    term: ClassVar[str]
    """Term of the calibration that fits it."""

    @property
    def numbers(self) -> tuple[str, ...]:
        """Names of its parameters in the calibration, without that of the link."""
        raise NotImplementedError

    @property
    def sizes(self) -> tuple[Size, ...]:
        """One for each parameter; compliance has one direction."""
        low = 0.0 if self.term == COMPLIANCE else -MAX_SIZE
        return tuple(Size(with_unit(one), low, MAX_SIZE, TYPICAL[self.term]) for one in self.numbers)


@dataclass(frozen=True, slots=True)
class LinkGeometry(TrackerEffect):
    """Errors of the six parameters of a link."""

    name: ClassVar[str] = "link geometry"
    family: ClassVar[Family] = Family.GEOMETRY
    term: ClassVar[str] = GEOMETRY
    place: str

    @property
    def numbers(self) -> tuple[str, ...]:
        """Names in the order of the arm file."""
        return GEOMETRY_NAMES


@dataclass(frozen=True, slots=True)
class JointCompliance(TrackerEffect):
    """Rotation of a joint in proportion to its gravity torque."""

    name: ClassVar[str] = "joint compliance"
    family: ClassVar[Family] = Family.TRANSMISSION
    term: ClassVar[str] = COMPLIANCE
    place: str

    @property
    def numbers(self) -> tuple[str, ...]:
        """One name."""
        return (COMPLIANCE,)


@dataclass(frozen=True, slots=True)
class DirectionHysteresis(TrackerEffect):
    """Joint error that depends on the direction from which the joint came."""

    name: ClassVar[str] = "direction hysteresis"
    family: ClassVar[Family] = Family.TRANSMISSION
    term: ClassVar[str] = HYSTERESIS
    place: str

    @property
    def numbers(self) -> tuple[str, ...]:
        """One name."""
        return (HYSTERESIS,)


@dataclass(frozen=True, slots=True)
class PeriodicJointError(TrackerEffect):
    """Joint error that repeats with the turn of the joint, of all orders up to a highest one."""

    name: ClassVar[str] = "periodic joint error"
    family: ClassVar[Family] = Family.GEOMETRY
    term: ClassVar[str] = PERIODIC
    place: str
    orders: int

    @property
    def numbers(self) -> tuple[str, ...]:
        """Cosines, then sines."""
        return tuple(coefficient_names(self.orders)[len(NON_PERIODIC) :])


TYPICAL: Final = {GEOMETRY: 1e-3, COMPLIANCE: 1e-5, HYSTERESIS: 1e-4, PERIODIC: 1e-4}
"""Sizes that an industrial arm may have."""


def with_unit(number: str) -> str:
    """Return the name of a parameter with its unit, as in the arm file."""
    if number == COMPLIANCE:
        return f"{number}_rad_per_Nm"
    return f"{number}_{'m' if number in LENGTHS else 'rad'}"


def patch_arm(arm: SerialArm, effects: Sequence[Effect], sizes: Sequence[Sequence[float]]) -> SerialArm:
    """Add effects to an arm.

    Args:
        arm: Arm of the file.
        effects: Effects; those of this module are added.
        sizes: Sizes of each effect, in their units.

    Returns:
        The arm with the effects.
    """
    links = {one.name: one for one in arm.links}
    for effect, size in zip(effects, sizes, strict=True):
        if isinstance(effect, TrackerEffect):
            links[effect.place] = _patch_link(links[effect.place], effect, size)
    return replace(arm, links=tuple(links.values()))


def _patch_link(link: Link, effect: TrackerEffect, size: Sequence[float]) -> Link:
    if isinstance(effect, PeriodicJointError):
        orders = max(effect.orders, len(link.cos_rad or ()))
        waves = link.periodic_rad(orders)
        waves[:, : effect.orders] += np.reshape(size, (2, effect.orders))
        return replace(link, cos_rad=tuple(waves[0].tolist()), sin_rad=tuple(waves[1].tolist()))
    names = [with_unit(number) for number in effect.numbers]
    added = {name: getattr(link, name) + float(value) for name, value in zip(names, size, strict=True)}
    return replace(link, **added)
