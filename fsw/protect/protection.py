"""Protection, the last stage of a cycle: monitor the arm and decide a response that only reduces or stops."""

from fsw.dictionary.evrs import Evr
from fsw.kinematics.transforms import Array
from fsw.messages import Sensors
from fsw.protect.bounds import ProtectionBounds
from fsw.protect.monitors import MonitorState, run_monitors
from fsw.protect.motors import check_setpoint
from fsw.protect.responses import Decision, StandingFault, decide
from fsw.protect.status import ArmStatus


def protect(
    bounds: ProtectionBounds,
    last: MonitorState,
    fault: StandingFault | None,
    arm: ArmStatus,
    sensors: Sensors,
    last_rad: Array,
    unusable: tuple[Evr, ...],
    of_move: tuple[Evr, ...],
) -> tuple[MonitorState, Decision | None]:
    """Monitor the arm in this cycle and decide what is done.

    Args:
        bounds: Bounds of protection.
        last: State of the monitors after the cycle before.
        fault: Fault that stands already.
        arm: Arm with its joints and move in this cycle.
        sensors: Readings of this cycle.
        last_rad: Set-point that went out last, shape (5,).
        unusable: What `check_readings` found in these readings.
        of_move: Events of the move in this cycle, among them its own faults.

    Returns:
        The state of the monitors for the next cycle, and the decision; None if nothing happened.
    """
    state, found = run_monitors(bounds, last, arm, sensors, usable=not unusable)
    found = unusable + found
    if arm.move is not None:
        found += check_setpoint(bounds, arm.move, last_rad)
    found += of_move
    return state, decide(bounds, arm.mode, fault, found, arm.motor_rad, last_rad) if found else None
