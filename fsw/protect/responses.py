"""Fault response: one table from faults to few responses. A response may only reduce or stop."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np

from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import Evr, FaultResponse
from fsw.dictionary.faults import (
    ContactInFreeSpace,
    ContactLost,
    CurrentImplausible,
    CycleCountWrong,
    CyclesMissed,
    Fault,
    FollowingErrorHigh,
    HardstopImplausible,
    HardstopMissed,
    HardstopMoved,
    HardstopUnclear,
    MotorStalled,
    MotorStuck,
    NoContact,
    NotSettled,
    OverCurrent,
    OverTemperature,
    PreloadOutside,
    ReadingImplausible,
    ResolverDisagrees,
    SensorFrozen,
    SetpointUnsafe,
    SoftLimitPassed,
    StalledEarly,
    TiltChanged,
    UnderTemperature,
    UnexpectedContact,
)
from fsw.kinematics.transforms import Array
from fsw.protect.inputs import ProtectionBounds


class Response(StrEnum):
    """Responses to a fault, the severest first; each ends the command and its sequence."""

    POWER_OFF = "POWER_OFF"
    """Apply the brakes and take the power off at once; refuse moves until cleared."""
    BRAKE_AND_REFUSE = "BRAKE_AND_REFUSE"
    """Hold the motors where they are, apply the brakes, then power off; refuse moves until cleared."""
    STOP_AND_BRAKE = "STOP_AND_BRAKE"
    """Bring a move on its way to rest as a commanded stop does, any other at once; apply the brakes."""


RESPONSE_TO: Final[dict[type[Fault], Response]] = {
    ReadingImplausible: Response.BRAKE_AND_REFUSE,
    SensorFrozen: Response.BRAKE_AND_REFUSE,
    CyclesMissed: Response.STOP_AND_BRAKE,
    CycleCountWrong: Response.STOP_AND_BRAKE,
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
    UnexpectedContact: Response.BRAKE_AND_REFUSE,
    ContactLost: Response.STOP_AND_BRAKE,
    PreloadOutside: Response.BRAKE_AND_REFUSE,
    NoContact: Response.BRAKE_AND_REFUSE,
    NotSettled: Response.BRAKE_AND_REFUSE,
    StalledEarly: Response.BRAKE_AND_REFUSE,
    HardstopMissed: Response.BRAKE_AND_REFUSE,
    HardstopMoved: Response.BRAKE_AND_REFUSE,
    HardstopUnclear: Response.BRAKE_AND_REFUSE,
    HardstopImplausible: Response.BRAKE_AND_REFUSE,
    MotorStuck: Response.BRAKE_AND_REFUSE,
    CurrentImplausible: Response.BRAKE_AND_REFUSE,
}
"""Every fault has its row; an EVR that is no fault has none."""


EventKey = tuple[type[Evr], object]
"""Class of an event, and the joint, sensor or switch that it is about."""


@dataclass(frozen=True, slots=True)
class StandingFault:
    """Fault that the ground has not cleared: its mode and what has been reported since."""

    mode: Mode
    """Mode in which the fault happened."""
    reported: frozenset[EventKey]

    @property
    def may_touch(self) -> bool:
        """Return whether the arm may be in contact with something."""
        on_contact = any(event in (ContactInFreeSpace, UnexpectedContact) for event, _ in self.reported)
        return on_contact or self.mode in (Mode.GUARDED, Mode.RETRACTING, Mode.PRELOAD)


@dataclass(frozen=True, slots=True, eq=False)
class Decision:
    """Responses to the events of a cycle."""

    response: Response | None
    """None where the move goes on as it is."""
    fault: StandingFault | None
    """Fault that stands after this cycle."""
    evrs: tuple[Evr, ...]
    """Events to report."""
    hold_rad: Array
    """Motor angles to hold where the response applies the brakes at once, (5,)."""


def decide(
    bounds: ProtectionBounds,
    mode: Mode,
    fault: StandingFault | None,
    found: tuple[Evr, ...],
    motor_rad: Array,
    last_rad: Array,
) -> Decision:
    """Decide the response to the events of a cycle.

    While a fault stands there is no further response, because the brakes are on or being applied. Each new
    event is still reported once.

    Motors are held at their measured angles, so a motor that lags is not driven on. These angles are clipped
    to the following error around the last set-point, so a wrong reading is not followed far.
    """
    lag = bounds.monitors.following_error_rad
    hold_rad = np.clip(motor_rad, last_rad - lag, last_rad + lag)
    if fault is not None:
        new = tuple(evr for evr in found if identify(evr) not in fault.reported)
        reported = fault.reported.union(identify(evr) for evr in new)
        return Decision(None, StandingFault(fault.mode, reported), new, hold_rad)
    response = response_to(found)
    if response is None:
        return Decision(None, None, found, hold_rad)
    evrs = (*found, FaultResponse(response.value))
    if response is Response.STOP_AND_BRAKE:
        return Decision(response, None, evrs, hold_rad)
    fault = StandingFault(mode, frozenset(identify(evr) for evr in found))
    return Decision(response, fault, evrs, hold_rad)


def response_to(evrs: tuple[Evr, ...]) -> Response | None:
    """Return the severest response that these events ask for, or None."""
    requested = {RESPONSE_TO[type(evr)] for evr in evrs if isinstance(evr, Fault)}
    return next((response for response in Response if response in requested), None)


def identify(evr: Evr) -> EventKey:
    """Return the key by which two events count as one."""
    about = next((getattr(evr, name) for name in ("joint", "sensor", "switch") if hasattr(evr, name)), None)
    return type(evr), about
