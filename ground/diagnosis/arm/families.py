"""Families of the effects of this arm: the middle level of a verdict."""

from typing import Final

from diagnosis.effects.effect import Family
from sim.effects import cables, environment, gears, geometry, joints, links, motors, sensors, structure
from sim.effects.effect import Effect

FAMILIES: Final[dict[Family, tuple[type[Effect], ...]]] = {
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
        *(geometry.LinkWarming, geometry.Warming, joints.HardstopAngle),
    ),
    Family.STRUCTURE: (
        *(structure.LinkStiffness, structure.LinkBending, structure.LinkTorsion, structure.LinkCreep),
        structure.RoverCompliance,
    ),
    Family.INERTIA: (structure.LinkMass, structure.TurretMass, structure.TurretCentre),
    Family.CONTACT: (environment.ContactStiffness, environment.SurfacePosition, joints.HardstopStiffness),
    Family.EXTERNAL: (cables.FlexCable, cables.Counterbalance),
}


def family_of(kind: type[Effect]) -> Family:
    """Return the family of an effect that a diagnosis can name.

    Args:
        kind: Class of the effect.

    Raises:
        StopIteration: It has none, which is a bug; a test holds the table to the catalogue.
    """
    return next(family for family, kinds in FAMILIES.items() if kind in kinds)
