"""Fit of a run against the hardstop, from synthetic readings."""

import numpy as np
import pytest

from fsw.dictionary.enums import Joint
from fsw.estimate.reference import Readings, fit_contact_line, locate_hardstop, measure_backlash
from tests.fsw.rig import config_of

CONFIG = config_of()
SPEED_RAD_S, HZ = 1.7e-3, 64.0
NOISE_A = 0.02
STOP_RAD = -3.0


def carried(
    angle: np.ndarray, load: float, friction: float, gap: float, gear: float, stop: float
) -> np.ndarray:
    """Compute the gear torque over motor angles (n) in time: friction holds the output within its band."""
    low, high = (rest(angle, pull, gap, gear, stop) for pull in (load - friction, load + friction))
    output, outputs = float(high[0]), []
    for least, most in zip(low, high, strict=True):
        output = min(max(output, least), most)
        outputs.append(output)
    return gear_torque(np.array(outputs) - angle, gap, gear)


def rest(motor: np.ndarray, pull: float, gap: float, gear: float, stop: float) -> np.ndarray:
    """Find the rest angle of an output without friction under a load, by bisection."""
    below, above = motor - 0.05, motor + 0.05
    for _ in range(50):
        middle = 0.5 * (below + above)
        back = gear_torque(middle - motor, gap, gear) + stop * np.minimum(middle - STOP_RAD, 0.0)
        below, above = np.where(pull > back, middle, below), np.where(pull > back, above, middle)
    return 0.5 * (below + above)


def gear_torque(twist: np.ndarray, gap: float, gear: float) -> np.ndarray:
    return gear * (twist - np.clip(twist, -gap / 2, gap / 2))


def run(joint: Joint, load: float, gap: float, gear: float, stop: float, motor_friction: float, seed: int):
    """Simulate readings towards the stop until the joint stalls, and back."""
    params = CONFIG.params.joints.in_order()[joint]
    rng = np.random.default_rng(seed)
    step = SPEED_RAD_S / HZ
    down = np.arange(STOP_RAD + 0.015, STOP_RAD - 0.03, -step)
    torque = carried(down, load, params.output_friction_Nm, gap, gear, stop)
    running = torque[300]
    stall = int(np.argmax(torque > running + params.hardstop_press_Nm))
    way = np.concatenate(
        [down[:stall], np.full(32, down[stall]), np.arange(down[stall], STOP_RAD + 0.01, step)]
    )
    torque = carried(way, load, params.output_friction_Nm, gap, gear, stop)
    motor = np.where(np.arange(way.size) < stall + 32, -motor_friction, motor_friction) - torque
    motor += params.torque_constant_Nm_A * NOISE_A * rng.standard_normal(way.size)
    towards, away = slice(0, stall + 32), slice(stall + 40, None)
    return Readings(way[towards], motor[towards]), Readings(way[away], motor[away])


LOADS = {Joint.ELEVATION: (-130.0, -60.0, -5.0, 0.0, 5.0), Joint.WRIST: (-12.0, -5.0, -1.0, 0.0)}
CASES = [(joint, load) for joint, loads in LOADS.items() for load in loads]


@pytest.mark.parametrize(("joint", "load"), CASES)
def test_stop_compliance_and_gap_are_found_whatever_friction_and_stiffness_are(joint, load):
    drawn = CONFIG.params.joints.in_order()[joint]
    gap, stop = 1.1 * drawn.backlash_rad, 0.85 * drawn.hardstop_stiffness_Nm_rad
    gear = 1.15 * drawn.gear_stiffness_Nm_rad
    for seed, friction in ((1, 60.0), (2, 400.0)):
        towards, away = run(joint, load, gap, gear, stop, friction, seed)
        press = fit_contact_line(CONFIG, joint, load, towards)
        assert press is not None
        assert press.compliance_rad_Nm == pytest.approx(1 / gear + 1 / stop, rel=0.06)
        width = measure_backlash(CONFIG, joint, load, press, away)
        assert width == pytest.approx(gap, abs=0.12e-3)
        assert locate_hardstop(CONFIG, joint, load, press, width).stop_rad == pytest.approx(
            STOP_RAD, abs=0.15e-3
        )


def test_a_load_that_lifts_the_output_off_its_stop_hides_the_gap():
    drawn = CONFIG.params.joints.in_order()[Joint.ELEVATION]
    towards, away = run(Joint.ELEVATION, 40.0, drawn.backlash_rad, 1e5, 2e5, 200.0, 3)
    press = fit_contact_line(CONFIG, Joint.ELEVATION, 40.0, towards)
    assert press is not None
    width = measure_backlash(CONFIG, Joint.ELEVATION, 40.0, press, away)
    assert width is None
    result = locate_hardstop(CONFIG, Joint.ELEVATION, 40.0, press, width)
    assert not result.backlash_measured
    assert 2 * result.half_backlash_rad == drawn.backlash_rad
    assert result.stop_rad == pytest.approx(STOP_RAD, abs=0.05e-3)


@pytest.mark.parametrize("width", [None, 1e-4, 2e-2, -1e-3])
def test_a_width_that_is_no_gap_leaves_the_drawing_s(width):
    towards, _ = run(Joint.WRIST, 0.0, 4e-3, 5e4, 2e5, 40.0, 4)
    press = fit_contact_line(CONFIG, Joint.WRIST, 0.0, towards)
    assert press is not None
    result = locate_hardstop(CONFIG, Joint.WRIST, 0.0, press, width)
    assert 2 * result.half_backlash_rad == pytest.approx(2 * CONFIG.half_backlash_rad[Joint.WRIST])


def test_few_readings_and_readings_without_a_rise_have_no_line():
    flat = Readings(np.linspace(0.03, 0.0, 800), -40.0 + np.random.default_rng(5).standard_normal(800))
    for readings in (flat, Readings(np.zeros(3), np.zeros(3))):
        assert fit_contact_line(CONFIG, Joint.WRIST, 0.0, readings) is None
