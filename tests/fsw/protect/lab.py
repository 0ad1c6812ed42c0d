"""An arm in plain values to which nothing happens, and the readings of its sensors."""

from pathlib import Path

import numpy as np

from fsw.dictionary.enums import Mode
from fsw.protect import monitors
from fsw.protect.inputs import ArmStatus, MoveStatus, PressStatus
from fsw.protect.readings import ReadingState
from tests.fsw.rig import MARS_R_m_s2, config_of, quiet_sensors
from tests.tools import SWITCHES

CONFIG = config_of()
PARAMS = CONFIG.params
JOINTS = PARAMS.joints.in_order()
BOUNDS = CONFIG.protection
MONITORS = PARAMS.monitors
STIFFNESS = CONFIG.arm.gear_stiffness_Nm_rad
READY = np.array(PARAMS.poses.ready_rad)
ZERO = np.zeros(5)
WOUND_RAD = CONFIG.half_backlash_rad + 0.02
"""Gears that a load holds far out on a flank."""

PAGE = Path(__file__).parents[3] / "docs" / "faults.md"

STILL = MoveStatus(
    READY, ZERO, is_stopping=False, is_releasing=False, homing=None, approaching=None, press=None
)
RESTING = ArmStatus(
    mode=Mode.DEPLOYED,
    tool="apxs",
    calibrated=np.ones(5, bool),
    motor_rad=READY,
    motor_rate_rad_s=ZERO,
    gear_rad=WOUND_RAD,
    gear_lowest_rad=WOUND_RAD,
    gear_highest_rad=WOUND_RAD,
    gear_uncertainty_rad=ZERO,
    side=np.ones(5),
    half_backlash_rad=CONFIG.half_backlash_rad,
    resolver_error_rad=ZERO,
    resolver_bias_rad=ZERO,
    gravity_R_m_s2=MARS_R_m_s2,
    imu_R_m_s2=MARS_R_m_s2,
    move=None,
)


def resting(**changes):
    """The arm on its brakes."""
    return RESTING._replace(**changes)


def moving(move=STILL, mode=Mode.FREE_SPACE, **changes):
    """The arm in a move."""
    return RESTING._replace(mode=mode, move=move, **changes)


def a_move(**changes):
    return STILL._replace(**changes)


def a_press(tool="drill", force_N=100.0, torque_per_N=ZERO, at_touch_rad=ZERO):
    return PressStatus(tool, force_N, np.asarray(torque_per_N, float), at_touch_rad)


def sensors(cycle=0, **readings):
    return quiet_sensors(np.zeros(5), cycle, **readings)


def noisy_readings(read):
    """The numbers that have noise, in the order of NOISY."""
    return (
        *read.resolver_rad.tolist(),
        *read.current_A.tolist(),
        *read.gravity_R_m_s2.tolist(),
        read.structure_C,
    )


def with_readings(read, usable=True):
    """The history of readings that are all plausible, or cannot be used."""
    numbers = (*noisy_readings(read), *read.winding_C.tolist(), *read.encoder_count.tolist())
    return ReadingState(read.cycle, numbers, numbers if usable else ())


def run_monitors(bounds, last, arm, read, usable=True):
    return monitors.run_monitors(bounds, last, arm, read, with_readings(read, usable))


def at(joint, value, elsewhere=0.0):
    """A value at one joint."""
    return np.where(np.arange(5) == joint, value, elsewhere)


def closed(*switches):
    return np.isin(SWITCHES, switches)


def above(value):
    """The next number."""
    return np.nextafter(value, np.inf)


def below(value):
    return np.nextafter(value, -np.inf)


def assert_reports_from(persistence, check, event):
    """A check that takes the count of cycles before this one reports from its persistence on."""
    for count in range(persistence - 1):
        assert check(count) == (count + 1, ())
    for count in (persistence - 1, persistence, 7 * persistence):
        assert check(count) == (count + 1, (event,))


def rows(heading):
    """The cells of the table under a heading of the page of faults."""
    section = PAGE.read_text().split(f"## {heading}\n")[1].split("\n## ")[0]
    lines = [line for line in section.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def persistence_of(kind):
    """The persistence of a monitor, as the page has it: a number, or the name of a parameter."""
    said = next(row[3] for row in rows("Monitors") if row[0] == kind.__name__)
    first = said.split(":")[0].split(" ")[0]
    return int(first) if first.isdigit() else getattr(MONITORS, said.strip("`"))
