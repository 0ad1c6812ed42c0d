"""What a joint's run against its hardstop tells: where the stop is, how much gives way, how wide the gap is.

Motor torque is current times its constant. Running slowly towards the stop it is the friction of motor and
gear and the torque that the gear carries, T = load + friction of the output. On the stop T rises by the line

    T = T_running + (angle of contact - motor angle) / compliance

with the compliances of gear and stop in series, both as they are today: friction, and whatever else was there
before the stop was, is in the current before it. So the line, taken back to the running current, is the motor
angle at which the output met its stop, wherever it lay in its gap before: output = motor + b/2 + T / K.

Running back, the line is followed down to where the gear carries nothing. There it crosses its gap, at the
current of friction alone, until it takes up the load of the output again: that is how wide the gap is.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from fsw.config import Config
from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import JointCalibrated
from fsw.kinematics.transforms import Array

RISE: Final = (0.2, 0.85)
"""The share of the rise to which the line is fitted: clear of both knees."""
BEFORE_RAD: Final = 3e-4
RUNNING_RAD: Final = 4e-3
"""From so far before contact, readings over such a way tell what running takes."""
LATEST_READINGS: Final = 5
PASSES: Final = 3
BEYOND: Final = 0.3
"""The last share of the gap's width on the way back, where the output moves along."""
PLATEAU: Final = (0.15, 0.7)
"""The share of the gap whose torque is taken for that of friction alone."""
MIN_READINGS: Final = 8
"""Readings that a line or a level is fitted to."""
MAX_LOAD_SHARE: Final = 0.5
"""A load that pushes off the stop by more than this share of the output's friction hides the gap."""
BACKLASH_FACTOR: Final = (0.5, 2.0)
"""Of the drawing's width; what seems outside is no gap."""


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Motor angles [rad, output side] and motor torques [N m] at a slow steady speed, in time."""

    motor_rad: Array
    torque_Nm: Array

    def append(self, motor_rad: float, torque_Nm: float) -> "Readings":
        """One reading more."""
        return Readings(np.append(self.motor_rad, motor_rad), np.append(self.torque_Nm, torque_Nm))


NO_READINGS: Final = Readings(np.zeros(0), np.zeros(0))


@dataclass(frozen=True, slots=True)
class ContactLine:
    """A joint's run against its hardstop."""

    contact_rad: float
    """Motor angle at which the line has the torque of running."""
    running_Nm: float
    """Magnitude of the motor torque before contact."""
    compliance_rad_Nm: float


@dataclass(frozen=True, slots=True)
class HardstopFit:
    """What is known of a joint now."""

    stop_rad: float
    """Angle of the output at its stop, in the joint's zero of before."""
    running_Nm: float
    compliance_rad_Nm: float
    half_gap_rad: float
    backlash_measured: bool

    def to_event(self, joint: Joint, moved_rad: float) -> JointCalibrated:
        """What is reported of it, the joint's zero having moved by so much."""
        return JointCalibrated(
            joint,
            moved_rad,
            self.running_Nm,
            1e6 * self.compliance_rad_Nm,
            2 * self.half_gap_rad,
            self.backlash_measured,
        )


def fit_contact_line(config: Config, joint: int, load_Nm: float, towards: Readings) -> ContactLine | None:
    """The line of a run towards the stop; None if there is none in it.

    `load_Nm` pulls the output to positive angles if positive. Of a load that pushes the output on its stop
    the gear is first relieved, and crosses its gap; the line counts from where it then takes up torque.
    """
    params = config.params.joints.in_order()[joint]
    angle, push = towards.motor_rad, -towards.torque_Nm
    if push.size < MIN_READINGS:
        return None
    relieved = max(0.0, -(load_Nm + params.output_friction_Nm))
    gap = 2 * config.half_gap_rad[joint] * BACKLASH_FACTOR[1] if relieved > 0 else 0.0
    low, high = (relieved + share * (params.hardstop_press_Nm - relieved) for share in RISE)
    level = float(push[-LATEST_READINGS:].mean()) - params.hardstop_press_Nm
    for _ in range(PASSES):
        line = _line(angle, push - level, low, high)
        if line is None:
            return None
        contact, compliance = line
        before = angle - (contact + gap + BEFORE_RAD)
        running = push[(before > 0) & (before < RUNNING_RAD)]
        if running.size < MIN_READINGS:
            return None
        level = float(running.mean())
    return ContactLine(contact, level, compliance)


def _line(angle: Array, rise: Array, low: float, high: float) -> tuple[float, float] | None:
    """Where the line of the last rise from low to high begins, and its compliance."""
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
    """The width of the gap crossed on the way back from the stop; None where none shows."""
    params = config.params.joints.in_order()[joint]
    friction, drawn = params.output_friction_Nm, 2 * float(config.half_gap_rad[joint])
    taken_up = friction - load_Nm
    if taken_up < MAX_LOAD_SHARE * friction:
        return None
    angle, push, compliance = away.motor_rad, away.torque_Nm, press.compliance_rad_Nm
    final = float(push[angle > angle.max() - BEYOND * drawn].mean())
    crossing = final - taken_up
    for _ in range(PASSES):
        fallen = (crossing - push) / (crossing - push.min())
        on_line = (fallen > RISE[0]) & (fallen < RISE[1])
        if np.count_nonzero(on_line) < MIN_READINGS:
            return None
        # the slope is that of pressing; only where the line lies is read here
        start = float(np.mean(angle[on_line] + (crossing - push[on_line]) * compliance))
        flat = (angle > start + PLATEAU[0] * drawn) & (angle < start + PLATEAU[1] * drawn)
        if np.count_nonzero(flat) < MIN_READINGS:
            return None
        crossing = float(push[flat].mean())
    beyond = angle > start + PLATEAU[1] * drawn
    angle, excess = angle[beyond], push[beyond] - 0.5 * (crossing + final)
    half_way = float(angle[int(np.argmin(np.cumsum(excess)))])
    gives = compliance if -load_Nm > friction else 1.0 / params.gear_stiffness_Nm_rad
    return half_way - 0.5 * (final - crossing) * gives - start


def locate_hardstop(
    config: Config, joint: int, load_Nm: float, press: ContactLine, width_rad: float | None
) -> HardstopFit:
    """Where the stop is, given the line and the gap."""
    drawn = 2 * float(config.half_gap_rad[joint])
    measured = drawn if width_rad is None else width_rad
    believable = width_rad is not None and BACKLASH_FACTOR[0] < measured / drawn < BACKLASH_FACTOR[1]
    half = 0.5 * (measured if believable else drawn)
    carried_Nm = load_Nm + float(config.output_friction_Nm[joint])
    gear = press.compliance_rad_Nm * gear_compliance_share(config, joint)
    return HardstopFit(
        stop_rad=press.contact_rad + half + carried_Nm * gear,
        running_Nm=press.running_Nm,
        compliance_rad_Nm=press.compliance_rad_Nm,
        half_gap_rad=half,
        backlash_measured=believable,
    )


def series_compliance(config: Config, joint: int) -> float:
    """Of gear and hardstop as drawn, rad / (N m)."""
    params = config.params.joints.in_order()[joint]
    return 1.0 / params.gear_stiffness_Nm_rad + 1.0 / params.hardstop_stiffness_Nm_rad


def gear_compliance_share(config: Config, joint: int) -> float:
    """The gear's share of that; a measured compliance is divided likewise."""
    return 1.0 / (
        config.params.joints.in_order()[joint].gear_stiffness_Nm_rad * series_compliance(config, joint)
    )
