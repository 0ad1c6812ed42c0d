"""Whether the arm is in its stow, and what a stop ends in."""

import numpy as np

from fsw.config import Config
from fsw.dictionary.enums import Mode
from fsw.estimate.joints import JointEstimate
from fsw.executive.modes import Event


def stop_event(config: Config, mode: Mode, joints: JointEstimate) -> Event:
    """Which stop it is: an arm that has not left the stowed pose stays stowed."""
    still_stowed = mode is Mode.FREE_SPACE and at_stow(config, joints)
    return Event.STOP_STOWED if still_stowed else Event.STOP


def at_stow(config: Config, joints: JointEstimate) -> bool:
    """Whether every joint is known to be in its stowed place."""
    off = np.abs(joints.motor_rad - config.params.poses.stowed_rad).max()
    return bool(joints.reference.calibrated.all() and off < config.params.motion.stowed_rad)
