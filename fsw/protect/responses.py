"""What is done about what happened: one table, few responses. A response only reduces or stops."""

from enum import StrEnum
from typing import Final

from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import (
    ContactInFreeSpace,
    ContactLost,
    CurrentImplausible,
    CyclesMissed,
    Fault,
    FollowingErrorHigh,
    GravityImplausible,
    HardstopMissed,
    HardstopMoved,
    HardstopUnclear,
    MotorStalled,
    MotorStuck,
    NoContact,
    NoHardstop,
    NotSettled,
    OverCurrent,
    OverTemperature,
    PreloadOutside,
    ResolverDisagrees,
    SensorFrozen,
    SensorNotFinite,
    SetpointUnsafe,
    SoftLimitPassed,
    StalledEarly,
    TiltChanged,
    UnderTemperature,
)


class Response(StrEnum):
    """What can be done about a fault, the severest first; each ends the command and its sequence."""

    POWER_OFF = "POWER_OFF"
    """Brakes on and power off at once; refuse moves until cleared."""
    BRAKE_AND_REFUSE = "BRAKE_AND_REFUSE"
    """Hold the motors where they are, brakes at once, then power off; refuse moves until cleared."""
    STOP_AND_BRAKE = "STOP_AND_BRAKE"
    """Bring a move on its way to rest as a commanded stop does, any other at once; brakes on; no more."""


RESPONSE_TO: Final[dict[type[Fault], Response]] = {
    SensorNotFinite: Response.BRAKE_AND_REFUSE,
    SensorFrozen: Response.BRAKE_AND_REFUSE,
    GravityImplausible: Response.BRAKE_AND_REFUSE,
    CyclesMissed: Response.STOP_AND_BRAKE,
    TiltChanged: Response.BRAKE_AND_REFUSE,
    SetpointUnsafe: Response.BRAKE_AND_REFUSE,
    SoftLimitPassed: Response.BRAKE_AND_REFUSE,
    OverCurrent: Response.POWER_OFF,
    OverTemperature: Response.POWER_OFF,
    UnderTemperature: Response.STOP_AND_BRAKE,
    MotorStalled: Response.BRAKE_AND_REFUSE,
    FollowingErrorHigh: Response.BRAKE_AND_REFUSE,
    ResolverDisagrees: Response.BRAKE_AND_REFUSE,
    ContactInFreeSpace: Response.BRAKE_AND_REFUSE,
    ContactLost: Response.STOP_AND_BRAKE,
    PreloadOutside: Response.BRAKE_AND_REFUSE,
    NoContact: Response.BRAKE_AND_REFUSE,
    NotSettled: Response.BRAKE_AND_REFUSE,
    StalledEarly: Response.BRAKE_AND_REFUSE,
    HardstopMissed: Response.BRAKE_AND_REFUSE,
    HardstopMoved: Response.BRAKE_AND_REFUSE,
    HardstopUnclear: Response.BRAKE_AND_REFUSE,
    NoHardstop: Response.BRAKE_AND_REFUSE,
    MotorStuck: Response.BRAKE_AND_REFUSE,
    CurrentImplausible: Response.BRAKE_AND_REFUSE,
}
"""Every fault has its row; an EVR that is no fault has none."""


def response_to(evrs: tuple[Evr, ...]) -> Response | None:
    """The severest response that these events ask for, or None."""
    asked = {RESPONSE_TO[type(evr)] for evr in evrs if isinstance(evr, Fault)}
    return next((response for response in Response if response in asked), None)
