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
        return Drive(
            last.setpoint_count, np.zeros(n), config.current_limit_A, _constant(False, n), _constant(False, n)
        )
    on = _constant(True, n)
    release = _constant(False, n) if move.phase is Phase.BRAKE else on
    if last.power_on.any() and np.array_equal(last.brake_release, release):
        on, release = last.power_on, last.brake_release
    count = np.rint((move.hold.motor_rad - joints.zero_rad) / config.rad_per_count).astype(np.int64)
    return Drive(count, move.hold.rate_rad_s, config.current_limit_A, on, release)
