"""What is done about what happened: one table, few responses. A response only reduces or stops."""

from enum import StrEnum
from typing import Final

from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import (
    ContactInFreeSpace,
    CurrentImplausible,
    FollowingErrorHigh,
    GravityImplausible,
    HardstopMissed,
    HardstopMoved,
    HardstopUnclear,
    MotorStuck,
    NoContact,
    NoHardstop,
    NotSettled,
    OverCurrent,
    ResolverDisagrees,
    SensorNotFinite,
    SetpointUnsafe,
    SoftLimitPassed,
    StalledEarly,
)


class Response(StrEnum):
    """What can be done about a fault."""

    BRAKE_AND_REFUSE = "BRAKE_AND_REFUSE"
    """Hold the motors where they are, brakes at once, then power off; refuse moves until cleared."""


RESPONSE_TO: Final[dict[type[Evr], Response]] = {
    SensorNotFinite: Response.BRAKE_AND_REFUSE,
    GravityImplausible: Response.BRAKE_AND_REFUSE,
    SetpointUnsafe: Response.BRAKE_AND_REFUSE,
    SoftLimitPassed: Response.BRAKE_AND_REFUSE,
    OverCurrent: Response.BRAKE_AND_REFUSE,
    FollowingErrorHigh: Response.BRAKE_AND_REFUSE,
    ContactInFreeSpace: Response.BRAKE_AND_REFUSE,
    HardstopMissed: Response.BRAKE_AND_REFUSE,
    HardstopMoved: Response.BRAKE_AND_REFUSE,
    MotorStuck: Response.BRAKE_AND_REFUSE,
    HardstopUnclear: Response.BRAKE_AND_REFUSE,
    CurrentImplausible: Response.BRAKE_AND_REFUSE,
    NoHardstop: Response.BRAKE_AND_REFUSE,
    ResolverDisagrees: Response.BRAKE_AND_REFUSE,
    StalledEarly: Response.BRAKE_AND_REFUSE,
    NoContact: Response.BRAKE_AND_REFUSE,
    NotSettled: Response.BRAKE_AND_REFUSE,
}
"""An EVR that is not here is no fault."""


def response_to(evrs: tuple[Evr, ...]) -> Response | None:
    """The response that these events ask for, or None."""
    return next((RESPONSE_TO[type(evr)] for evr in evrs if type(evr) in RESPONSE_TO), None)
