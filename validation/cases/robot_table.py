"""Effects of the cases: their places, their sizes, and what a case counts as a hypothesis."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from simgap.robot import Robot, RobotJoint
from validation.cases import robot_inside as inside
from validation.cases import robot_outside as outside
from validation.cases.robot_setup import MODELS
from validation.cases.robot_truth import TrueEffect


@dataclass(frozen=True, slots=True)
class Entry:
    """Effect with its sizes."""

    kind: type[TrueEffect]
    unit: str
    """"1": the sizes are as they stand; "torque": of the torque limit; "armature"; "flex": of 1 / gain."""
    typical: float
    """Start of the search for a size."""
    high: float
    """Largest size that a robot of this kind may have."""
    is_signed: bool = False
    needs: str = ""
    """Joint that may have it: "known", "loaded", "inner" or "neighbour"; empty: all."""


ENTRIES: Final = (
    Entry(inside.CommandDelay, "1", 0.005, 0.06),
    Entry(inside.MeasurementDelay, "1", 0.005, 0.06),
    Entry(inside.VelocityLimit, "1", 0.6, 4.0),
    Entry(inside.AccelerationLimit, "1", 0.04, 0.5),
    Entry(inside.TorqueLimit, "flex_limit", 1.0, 20.0),
    Entry(inside.ClampLow, "1", 0.05, 0.6),
    Entry(inside.ClampHigh, "1", 0.05, 0.6),
    Entry(inside.GainError, "1", 0.2, 0.5, True, "known"),
    Entry(inside.DeadZone, "1", 0.01, 0.06),
    Entry(inside.Integral, "1", 1.0, 6.0),
    Entry(inside.BackEmf, "1", 0.1, 1.0),
    Entry(inside.SupplySag, "1", 0.3, 0.9),
    Entry(inside.Armature, "armature", 0.3, 2.0, True, "known"),
    Entry(inside.Viscous, "damping", 0.3, 1.5, True, "known"),
    Entry(inside.Coulomb, "torque", 0.03, 0.2, False, "known"),
    Entry(inside.Stribeck, "torque", 0.03, 0.2),
    Entry(inside.LoadFriction, "1", 0.15, 0.6, False, "loaded"),
    Entry(inside.AsymmetricFriction, "friction", 0.3, 0.7, True),
    Entry(inside.TemperatureFriction, "friction", 0.4, 2.0),
    Entry(inside.Compliance, "flex", 0.3, 2.0),
    Entry(inside.Backlash, "1", 0.02, 0.1),
    Entry(inside.Payload, "mass", 0.3, 1.0),
    Entry(inside.LinkMass, "1", 0.3, 0.8, True, "loaded"),
    Entry(inside.LinkCentre, "1", 0.02, 0.06, True, "loaded"),
    Entry(inside.LinkLength, "1", 0.02, 0.06, True, "inner"),
    Entry(inside.JointZero, "1", 0.02, 0.1, True),
    Entry(inside.GravityDirection, "1", 0.05, 0.25, True),
    Entry(inside.Spring, "flex_torque", 0.05, 0.4),
    Entry(inside.PositionTorque, "torque", 0.03, 0.2),
    Entry(inside.ConstantTorque, "torque", 0.03, 0.2, True),
    Entry(inside.Plane, "1", 0.005, 0.12),
    Entry(inside.PeriodicError, "1", 0.003, 0.02),
    Entry(inside.EncoderScale, "1", 0.02, 0.1, True),
    Entry(inside.Coupling, "1", 0.1, 0.8, True, "neighbour"),
)
"""Effects of the catalogue."""

SERVO_ENTRIES: Final = tuple(
    one
    for one in ENTRIES
    if one.kind.build is TrueEffect.build
    and one.kind not in (inside.BackEmf, inside.SupplySag, inside.JointZero)
)
"""Those of a servo: a wrong zero is a tilted base there; its truth has a back-EMF and its own supply."""

OUTSIDE: Final = (
    Entry(outside.CreepingLink, "flex", 0.2, 2.0, False, "loaded"),
    Entry(outside.DriftingTorque, "torque", 0.03, 0.3),
    Entry(outside.Hysteresis, "torque", 0.05, 0.3),
    Entry(outside.WobblingBase, "tilt", 0.05, 0.4),
    Entry(outside.Cogging, "torque", 0.03, 0.3),
    Entry(outside.CommandDropout, "1", 0.06, 0.4),
    Entry(outside.StickySpot, "torque", 0.05, 0.4),
    Entry(outside.OneWayFriction, "torque", 0.03, 0.2),
    Entry(outside.EccentricGear, "1", 0.2, 0.7),
    Entry(outside.ThermalGain, "1", 2.0, 40.0, False, "loaded"),
    Entry(outside.SlackCable, "flex_torque", 0.2, 1.5),
    Entry(outside.QuantisedTorque, "torque", 0.05, 0.3),
    Entry(outside.HiddenMode, "armature", 0.3, 2.0),
    Entry(outside.AgeingFriction, "torque", 0.02, 0.15),
    Entry(outside.WanderingDelay, "1", 0.02, 0.12),
    Entry(outside.OneWayGain, "1", 0.2, 0.6),
)
"""Effects outside the catalogue."""

SUPPLY: Final = "supply"
"""Place of what concerns all motors."""
BASE: Final = "base"
"""Place of what concerns the base or the surroundings."""


@dataclass(frozen=True, slots=True)
class PlacedEntry:
    """Effect at a place."""

    entry: Entry
    place: str
    scale: float
    """Sizes of the entry are multiples of this at the place."""

    @property
    def key(self) -> str:
        """Return the name of the hypothesis."""
        return f"{self.place}: {self.entry.kind.name}"


def entries_of(robot: Robot) -> tuple[Entry, ...]:
    """Return the effects of the catalogue that the truth of a robot may have."""
    return SERVO_ENTRIES if MODELS[robot.name].is_servo else ENTRIES


def list_hypotheses(robot: Robot, entries: tuple[Entry, ...]) -> tuple[PlacedEntry, ...]:
    """List the effects of a table at all their places."""
    placed = ((entry, place, scale) for entry in entries for place, scale in _places(robot, entry))
    return tuple(PlacedEntry(*one) for one in placed)


def _places(robot: Robot, entry: Entry) -> Iterator[tuple[str, float]]:
    kind = entry.kind
    if kind is inside.GravityDirection:
        yield BASE, 1.0
    elif kind is inside.SupplySag:
        yield SUPPLY, 1.0
    elif kind is inside.Plane:
        if len(robot.joints) > 1:  # a plane under a pendulum stops it, or is not touched
            yield robot.tool_site, 1.0
    elif kind is outside.WobblingBase:
        first = next(joint for joint in robot.joints if joint.is_loaded_by_gravity)
        yield BASE, 1.0 / first.torque_limit_Nm
    elif kind is inside.Payload:
        body = int(robot.model.site(robot.tool_site).bodyid[0])
        yield robot.joints[-1].name, float(robot.model.body_mass[body])
    else:
        for k, joint in enumerate(robot.joints):
            if _may_have(robot, k, entry.needs):
                yield joint.name, _scale(robot, joint, entry.unit)


def _may_have(robot: Robot, index: int, needs: str) -> bool:
    joint = robot.joints[index]
    return (
        not needs
        or (needs == "known" and joint.is_known)
        or (needs == "loaded" and joint.is_loaded_by_gravity)
        or (needs == "neighbour" and index > 0 and robot.joints[index - 1].is_loaded_by_gravity)
        or (needs == "inner" and joint.is_loaded_by_gravity and joint is not robot.joints[-1])
    )


def _scale(robot: Robot, joint: RobotJoint, unit: str) -> float:
    dof = joint.dof_index
    return {
        "1": 1.0,
        "torque": joint.torque_limit_Nm,
        "flex": 1.0 / joint.kp_Nm_rad,
        "flex_limit": 1.0 / joint.torque_limit_Nm,
        "flex_torque": joint.torque_limit_Nm,
        "armature": float(robot.model.dof_armature[dof]),
        "damping": joint.kd_Nms_rad,
        "friction": float(robot.model.dof_frictionloss[dof]),
    }[unit]
