"""From the move under way to what the motor controllers and brakes are asked."""

from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.enums import Joint
from fsw.estimate.joints import JointEstimate
from fsw.messages import ActuatorCommand, Flags
from fsw.motion.move import Move, Phase

NONE: Final[Flags] = np.zeros(len(Joint), bool)
NONE.flags.writeable = False


def drive_for(
    config: Config, move: Move | None, joints: JointEstimate, last: ActuatorCommand
) -> ActuatorCommand:
    """Brakes on and power off without a move; its joints powered while it lasts, released until it brakes."""
    if move is None:
        if not (last.power_on.any() or last.vibrate):
            return last
        return ActuatorCommand(
            last.setpoint_count, np.zeros(NONE.size), config.current_limit_A, NONE, NONE, vibrate=False
        )
    # unchanged flags and limits are the same arrays, so that nobody compares them
    release = NONE if move.phase is Phase.BRAKE else move.active
    count = np.rint((move.hold.motor_rad - joints.reference.zero_rad) / config.rad_per_count).astype(np.int64)
    vibrate = move.vibrate and move.phase is Phase.RUN
    return ActuatorCommand(count, move.hold.rate_rad_s, move.limit_A, move.active, release, vibrate)
