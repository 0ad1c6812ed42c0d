"""Families and locations of the effects of this arm: the coarser levels of a verdict."""

from collections.abc import Sequence
from enum import StrEnum
from typing import Final

from marsarm.diagnosis.problem import Hypothesis
from sim.effects import cables, environment, gears, geometry, joints, links, motors, sensors, structure
from sim.effects.catalogue import catalogue
from sim.effects.effect import Effect
from simgap import Family


class ArmFamily(StrEnum):
    """Family that this arm has besides those of any robot."""

    STRUCTURE = "structure"
    """Links and rover that bend."""


FAMILIES: Final[dict[StrEnum, tuple[type[Effect], ...]]] = {
    Family.FRICTION: (
        *(gears.CoulombFriction, gears.AsymmetricFriction, gears.ViscousFriction, gears.StribeckFriction),
        *(gears.LoadFriction, gears.ColdFriction, gears.OutputFriction, gears.GearEfficiency),
        joints.GearFriction,
    ),
    Family.TRANSMISSION: (
        *(gears.GearHysteresis, gears.TransmissionError, gears.JointCoupling),
        *(joints.BacklashWidth, joints.GearStiffness),
    ),
    Family.ACTUATION: (motors.MotorConstant, motors.ServoGain, motors.BusSag),
    Family.TIMING: (
        *(motors.CommandDelay, sensors.CurrentGain, sensors.CurrentBias, sensors.CurrentCrosstalk),
        *(sensors.EncoderScale, sensors.EncoderZero, joints.ResolverBias, sensors.ResolverScale),
        *(sensors.ResolverEccentricity, sensors.GravityDirection),
    ),
    Family.GEOMETRY: (
        *(links.LinkLength, links.LinkAngle, links.ToolOffset, links.ToolTurn, links.ThermalGradient),
        *(geometry.Expansion, geometry.LinkWarming, geometry.Warming, joints.HardstopAngle),
    ),
    ArmFamily.STRUCTURE: (
        *(structure.LinkStiffness, structure.LinkBending, structure.LinkTorsion, structure.LinkCreep),
        structure.RoverCompliance,
    ),
    Family.INERTIA: (structure.LinkMass, structure.TurretMass, structure.TurretCentre),
    Family.CONTACT: (environment.ContactStiffness, environment.SurfacePosition, joints.HardstopStiffness),
    Family.EXTERNAL: (cables.FlexCable, cables.Counterbalance),
}
LOCATIONS: Final = {
    "contact-stiffness": "surface",
    "surface-position": "surface",
    "bus-sag": "power bus",
    "gravity-direction": "imu",
    "rover-compliance": "rover",
    "turret-mass": "turret",
    "turret-centre": "turret",
}
"""Locations of effects whose place is an axis or the whole arm."""


def list_families(hypotheses: Sequence[Hypothesis]) -> tuple[StrEnum, ...]:
    """List the families of hypotheses.

    Args:
        hypotheses: Hypotheses of the catalogue.
    """
    return tuple(family_of(catalogue()[one.effect]) for one in hypotheses)


def list_locations(hypotheses: Sequence[Hypothesis]) -> tuple[str, ...]:
    """List the locations of hypotheses: joints, links, tools, or what `LOCATIONS` names.

    Args:
        hypotheses: Hypotheses of the catalogue.
    """
    return tuple(locate(one.effect, one.place) for one in hypotheses)


def locate(effect: str, place: str) -> str:
    """Return the location of an effect: its place without axis and direction.

    Args:
        effect: Name of the effect.
        place: Its place, such as "arm3.x", "elbow.positive" or "tool.drill".
    """
    return LOCATIONS.get(effect) or place.removeprefix("tool.").split(".")[0]


def family_of(kind: type[Effect]) -> StrEnum:
    """Return the family of an effect that a diagnosis can name.

    Args:
        kind: Class of the effect.

    Raises:
        StopIteration: It has none, which is a bug; a test holds the table to the catalogue.
    """
    return next(family for family, kinds in FAMILIES.items() if kind in kinds)
