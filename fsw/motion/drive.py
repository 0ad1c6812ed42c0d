"""From the move under way to what the motor controllers and brakes are asked."""

import numpy as np

from fsw.config import Config
from fsw.estimate.joints import JointEstimate
from fsw.messages import Drive, Flags
from fsw.motion.move import Move, Phase


def _constant(value: bool, n: int) -> Flags:
    flags = np.full(n, value)
    flags.flags.writeable = False
    return flags


def drive_for(config: Config, move: Move | None, joints: JointEstimate, last: Drive) -> Drive:
    """Brakes on and power off without a move; power while a move lasts; brakes released until it brakes."""
    n = config.rad_per_count.size
    if move is None:
        if not last.power_on.any():
            return last
        off = _constant(False, n)
        return Drive(last.setpoint_count, np.zeros(n), config.current_limit_A, off, off)
    released = move.phase is not Phase.BRAKE
    # the flags are the same for all joints; unchanged ones are the same arrays, so that nobody compares them
    same = last.power_on[0] and last.brake_release[0] == released
    on, release = (
        (last.power_on, last.brake_release) if same else (_constant(True, n), _constant(released, n))
    )
    count = np.rint((move.hold.motor_rad - joints.zero_rad) / config.rad_per_count).astype(np.int64)
    return Drive(count, move.hold.rate_rad_s, config.current_limit_A, on, release)
