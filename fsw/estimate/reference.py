"""Reference of encoders and resolvers, and the fit of a run against the hardstop from which it comes.

The reference is kept while the power is off. The fit gives the position of the hardstop, the compliance of
stop and gear, and the backlash.

Motor torque is current times the torque constant. On the slow approach, the motor torque is the friction of
motor and gear plus the torque T = load + friction of the output. On the stop, T rises along the line

    T = T_running + (angle of contact - motor angle) / compliance

with the compliances of gear and stop in series. The running current contains the friction of the day. The
line therefore meets the running current at the motor angle of contact, wherever the output lay in its
backlash. There, output = motor + b/2 + T / K.

On the way back, the torque follows the line until the gear carries nothing. The motor then crosses the
backlash with the current of friction alone. At the end of the backlash the gear takes up the load of the
output again. The length of the crossing is the width of the backlash.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import JointCalibrated
from fsw.kinematics.transforms import Array
from fsw.messages import Flags

RISE: Final = (0.2, 0.85)
"""Share of the rise to which the line is fitted, clear of both ends."""
BEFORE_RAD: Final = 3e-4
"""Distance before contact at which the readings of running end."""
RUNNING_RAD: Final = 4e-3
"""Length of the way before contact whose readings give the running torque."""
LATEST_READINGS: Final = 5
"""Number of last readings that give the first estimate of the pressing torque."""
PASSES: Final = 3
"""Iterations of line and running torque."""
BEYOND: Final = 0.3
"""Share of the backlash at the end of the way back, where the gear moves the output."""
PLATEAU: Final = (0.15, 0.7)
"""Share of the backlash whose torque counts as friction alone."""
MIN_READINGS: Final = 8
"""Least number of readings of a line or a level."""
MAX_LOAD_SHARE: Final = 0.5
"""Load towards positive angles, as a share of the output friction, that hides the backlash."""
BACKLASH_FACTOR: Final = (0.5, 2.0)
"""Plausible width of the backlash, as a factor of the nominal width."""


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Motor angles and torques at a slow constant speed, in time order."""

    motor_rad: Array
    """Motor angles on the output side, (n,)."""
    torque_Nm: Array
    """Motor torques on the output side, (n,)."""

    def append(self, motor_rad: float, torque_Nm: float) -> "Readings":
        """Append one reading."""
        return Readings(np.append(self.motor_rad, motor_rad), np.append(self.torque_Nm, torque_Nm))


NO_READINGS: Final = Readings(np.zeros(0), np.zeros(0))


@dataclass(frozen=True, slots=True)
class ContactLine:
    """Line of torque over motor angle of a run against the hardstop."""

    contact_rad: float
    """Motor angle at which the line has the running torque."""
    running_Nm: float
    """Magnitude of the motor torque before contact."""
    compliance_rad_Nm: float
    """Compliance of gear and hardstop in series."""


@dataclass(frozen=True, slots=True)
class HardstopFit:
    """Result of the calibration of a joint."""

    stop_rad: float
    """Output angle at the hardstop, with the encoder zero before calibration."""
    running_Nm: float
    """Magnitude of the motor torque before contact."""
    compliance_rad_Nm: float
    """Compliance of gear and hardstop in series."""
    half_backlash_rad: float
    """Half the width of the backlash."""
    backlash_measured: bool
    """True if the width was measured; else it is nominal."""

    def to_event(self, joint: Joint, moved_rad: float) -> JointCalibrated:
        """Build the event report; moved_rad is the change of the encoder zero."""
        return JointCalibrated(
            joint,
            moved_rad,
            self.running_Nm,
            1e6 * self.compliance_rad_Nm,
            2 * self.half_backlash_rad,
            self.backlash_measured,
        )


def fit_contact_line(config: Config, joint: int, load_Nm: float, towards: Readings) -> ContactLine | None:
    """Fit the line of a run towards the hardstop, by its readings; None if they contain none.

    A load that pushes the output onto the stop is first taken off the gear, which then crosses its backlash.
    The line begins where the gear takes up torque again.
    """
    params = config.params.joints.in_order()[joint]
    if towards.motor_rad.size < MIN_READINGS:
        return None
    angle, push = towards.motor_rad, -_without_spikes(towards.torque_Nm)
    relieved = max(0.0, -(load_Nm + params.output_friction_Nm))
    crossing_rad = 2 * config.half_backlash_rad[joint] * BACKLASH_FACTOR[1] if relieved > 0 else 0.0
    low, high = (relieved + share * (params.hardstop_press_Nm - relieved) for share in RISE)
    level = float(push[-LATEST_READINGS:].mean()) - params.hardstop_press_Nm
    for _ in range(PASSES):
        line = _fit_line(angle, push - level, low, high)
        if line is None:
            return None
        contact, compliance = line
        before = angle - (contact + crossing_rad + BEFORE_RAD)
        running = push[(before > 0) & (before < RUNNING_RAD)]
        if running.size < MIN_READINGS:
            return None
        level = float(running.mean())
    return ContactLine(contact, level, compliance)


def _without_spikes(torque_Nm: Array) -> Array:
    """Return each torque as the median of it and its neighbours: a single wrong reading has no effect."""
    middle = np.median(np.stack((torque_Nm[:-2], torque_Nm[1:-1], torque_Nm[2:])), axis=0)
    smooth: Array = np.concatenate((torque_Nm[:1], middle, torque_Nm[-1:]))
    return smooth


def _fit_line(angle: Array, rise: Array, low: float, high: float) -> tuple[float, float] | None:
    """Fit the line of the last rise from low to high; return its start and compliance, or None."""
    below = np.flatnonzero(rise < low)
    first = int(below[-1]) + 1 if below.size else 0
    above = np.flatnonzero(rise[first:] > high)
    last = first + (int(above[0]) if above.size else rise.size - first)
    if last - first < MIN_READINGS:
        return None
    slope, offset = np.polyfit(angle[first:last], rise[first:last], 1)
    return (float(-offset / slope), float(-1.0 / slope)) if slope < 0 else None


def measure_backlash(
    config: Config, joint: int, load_Nm: float, press: ContactLine, away: Readings
) -> float | None:
    """Measure the width [rad] of the backlash on the way back from the hardstop; None if it does not show."""
    params = config.params.joints.in_order()[joint]
    friction, nominal = params.output_friction_Nm, 2 * float(config.half_backlash_rad[joint])
    taken_up = friction - load_Nm
    if taken_up < MAX_LOAD_SHARE * friction:
        return None
    angle, push, compliance = away.motor_rad, _without_spikes(away.torque_Nm), press.compliance_rad_Nm
    final = float(push[angle > angle.max() - BEYOND * nominal].mean())
    crossing = final - taken_up
    for _ in range(PASSES):
        fall = (crossing - push) / (crossing - push.min())
        on_line = (fall > RISE[0]) & (fall < RISE[1])
        if np.count_nonzero(on_line) < MIN_READINGS:
            return None
        # the run towards the stop gives the slope; only the position of the line is fitted here
        start = float(np.mean(angle[on_line] + (crossing - push[on_line]) * compliance))
        flat = (angle > start + PLATEAU[0] * nominal) & (angle < start + PLATEAU[1] * nominal)
        if np.count_nonzero(flat) < MIN_READINGS:
            return None
        crossing = float(push[flat].mean())
    beyond = angle > start + PLATEAU[1] * nominal
    if not beyond.any():
        return None
    angle, excess = angle[beyond], push[beyond] - 0.5 * (crossing + final)
    half_way = float(angle[int(np.argmin(np.cumsum(excess)))])
    gear_compliance = compliance if -load_Nm > friction else 1.0 / params.gear_stiffness_Nm_rad
    return half_way - 0.5 * (final - crossing) * gear_compliance - start


def locate_hardstop(
    config: Config, joint: int, load_Nm: float, press: ContactLine, width_rad: float | None
) -> HardstopFit:
    """Compute the output angle at the hardstop from the line of a run towards it, and the backlash.

    The width is nominal if the measured one is implausible, or None.
    """
    nominal = 2 * float(config.half_backlash_rad[joint])
    measured = nominal if width_rad is None else width_rad
    plausible = width_rad is not None and BACKLASH_FACTOR[0] < measured / nominal < BACKLASH_FACTOR[1]
    half = 0.5 * (measured if plausible else nominal)
    gear_Nm = load_Nm + float(config.output_friction_Nm[joint])
    gear_rad_Nm = press.compliance_rad_Nm * gear_compliance_share(config, joint)
    return HardstopFit(
        stop_rad=press.contact_rad + half + gear_Nm * gear_rad_Nm,
        running_Nm=press.running_Nm,
        compliance_rad_Nm=press.compliance_rad_Nm,
        half_backlash_rad=half,
        backlash_measured=plausible,
    )


def series_compliance(config: Config, joint: int) -> float:
    """Compute the nominal compliance of gear and hardstop in series, in rad / (N m)."""
    params = config.params.joints.in_order()[joint]
    return 1.0 / params.gear_stiffness_Nm_rad + 1.0 / params.hardstop_stiffness_Nm_rad


def gear_compliance_share(config: Config, joint: int) -> float:
    """Compute the share of the gear in that compliance; it also splits a measured compliance."""
    return 1.0 / (
        config.params.joints.in_order()[joint].gear_stiffness_Nm_rad * series_compliance(config, joint)
    )


@dataclass(frozen=True, slots=True, eq=False)
class Reference:
    """Reference of encoders and resolvers on the output side, in the order of Joint."""

    calibrated: Flags
    """True for joints that have found their hardstop; the values of others are provisional, (5,)."""
    known: Flags
    """True for joints calibrated at any time; a new result is compared with the last one, (5,)."""
    zero_rad: Array
    """Motor angle at encoder count 0, (5,)."""
    half_backlash_rad: Array
    """Half the width of the backlash, measured if possible, else nominal, (5,)."""
    resolver_bias_rad: Array
    """Resolver reading less estimated output at the calibration, (5,)."""
    friction_Nm: Array
    """Torque that turns a joint without load, (5,); infinite if it was never measured."""


def no_reference(config: Config) -> Reference:
    """Build the reference of an arm of which only the parameters are known."""
    zeros = np.zeros_like(config.half_backlash_rad)
    never = np.zeros(zeros.size, bool)
    return Reference(never, never, zeros, config.half_backlash_rad, zeros, np.full(zeros.size, np.inf))


def recount_joint(reference: Reference, joint: int, shift_rad: float) -> Reference:
    """Shift the encoder zero of a joint whose counter has jumped; the joint must be calibrated again."""
    this = np.arange(reference.zero_rad.size) == joint
    shifted = np.where(this, reference.zero_rad + shift_rad, reference.zero_rad)
    return replace(forget_joint(reference, joint), zero_rad=shifted)


def forget_joint(reference: Reference, joint: int) -> Reference:
    """Mark a joint as uncalibrated; its values stay as provisional ones."""
    others = np.arange(reference.zero_rad.size) != joint
    return replace(reference, calibrated=reference.calibrated & others)
