"""The interval observer of a gear and its guarantees, and the fit of a run against the hardstop."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from fsw.dictionary.enums import Joint
from fsw.estimate.gear import (
    LEAST,
    LIKELY,
    MOST,
    STILL_RAD,
    bound_gear,
    bound_loads,
    gear_after_motor_turn,
    gear_after_output_turn,
    load_error,
    locate_in_backlash,
)
from fsw.estimate.reference import Readings, fit_contact_line, locate_hardstop, measure_backlash
from tests.fsw.rig import MARS_R_m_s2, config_of

CONFIG = config_of()
HALF, FRICTION = CONFIG.half_backlash_rad, CONFIG.output_friction_Nm
STIFFNESS = CONFIG.arm.gear_stiffness_Nm_rad
ERROR = load_error(CONFIG, MARS_R_m_s2)

shares = hnp.arrays(float, 5, elements=st.floats(-1, 1))
motions = hnp.arrays(float, 5, elements=st.floats(-0.01, 0.01))
loads = hnp.arrays(float, 5, elements=st.floats(-40, 40))
gears = hnp.arrays(float, (5, 3), elements=st.floats(-0.005, 0.005)).map(
    lambda values: np.sort(values, axis=1)
)
histories = st.lists(st.tuples(motions, loads, shares), min_size=1, max_size=12)


def bounds(load_Nm):
    return bound_gear(CONFIG, HALF, bound_loads(CONFIG, load_Nm, MARS_R_m_s2))


def torque_Nm(gear_rad):
    """Compute the torque of a spring with a dead band."""
    return STIFFNESS * (gear_rad - np.clip(gear_rad, -HALF, HALF))


def true_gear(gear_rad, motion_rad, load_Nm):
    """Turn the motor while friction holds the output, then let the output slip as far as it must."""
    gear_rad = gear_rad - motion_rad
    carried = torque_Nm(gear_rad)
    left = np.clip(carried, load_Nm - FRICTION, load_Nm + FRICTION)
    up = left / STIFFNESS + np.where(left > 0, HALF, -HALF)
    down = left / STIFFNESS - np.where(left < 0, HALF, -HALF)
    return np.where(left > carried, up, np.where(left < carried, down, gear_rad))


@given(shares, histories)
def test_the_true_gear_angle_is_always_inside_and_no_side_is_claimed_that_it_is_not_on(start, history):
    truth, believed = start * HALF, np.column_stack([-HALF, np.zeros(5), HALF])
    for motion, load, error in history:
        truth = true_gear(truth, motion, load + error * ERROR)
        believed = gear_after_motor_turn(believed, motion, bounds(load))
        assert (believed[:, LEAST] <= truth + 1e-12).all()
        assert (truth <= believed[:, MOST] + 1e-12).all()
        side = locate_in_backlash(HALF, believed)[1]
        assert (side * truth >= np.abs(side) * (HALF - 2e-6)).all()


@given(gears, loads, motions)
def test_between_the_bounds_the_output_stands_still(gear, load, motion):
    under = bounds(load)
    after = gear_after_motor_turn(gear, motion, under)
    held = (after > under.lowest_rad) & (after < under.highest_rad)
    np.testing.assert_allclose((after + motion[:, None])[held], gear[held], atol=1e-15)


@given(gears, loads, st.floats(0, 0.005), st.floats(0, 0.005))
def test_a_motion_in_one_direction_may_be_taken_in_parts(gear, load, first, second):
    under = bounds(load)
    gear = gear_after_motor_turn(gear, np.zeros(5), under)
    for sign in (1.0, -1.0):
        parts = gear
        for motion in (first, second):
            parts = gear_after_motor_turn(parts, np.full(5, sign * motion), under)
        whole = gear_after_motor_turn(gear, np.full(5, sign * (first + second)), under)
        np.testing.assert_allclose(parts, whole, atol=1e-15)


@given(gears, loads, st.sampled_from([-1.0, 1.0]))
def test_an_output_that_was_dragged_is_known_but_for_the_error_of_the_load(gear, load, direction):
    after = gear_after_motor_turn(gear, np.full(5, 0.1 * direction), bounds(load))
    taken_up = load - direction * FRICTION
    decided = np.abs(taken_up) > ERROR
    np.testing.assert_allclose(after[:, LIKELY], true_gear(gear[:, 0], 0.1 * direction, load), atol=1e-15)
    np.testing.assert_array_equal(locate_in_backlash(HALF, after)[1][decided], np.sign(taken_up)[decided])
    width = after[:, MOST] - after[:, LEAST]
    np.testing.assert_allclose(width[decided], (2 * ERROR / STIFFNESS)[decided], atol=1e-15)
    certain = bound_gear(CONFIG, HALF, np.tile(load[:, None], 3))
    after = gear_after_motor_turn(gear, np.full(5, 0.1 * direction), certain)
    np.testing.assert_array_equal(after[:, LEAST], after[:, MOST])


@given(gears, loads)
def test_a_load_beyond_friction_and_error_holds_the_output_on_its_flank(gear, load):
    after = gear_after_motor_turn(gear, np.zeros(5), bounds(load))
    loaded = np.abs(load) > FRICTION + ERROR
    np.testing.assert_array_equal(locate_in_backlash(HALF, after)[1][loaded], np.sign(load)[loaded])


@given(gears, loads, motions)
def test_what_is_planned_is_what_a_motor_that_far_leaves(gear, load, moved):
    """For outputs that move, the planned gear angles are those at the end of the motor motion."""
    under = bounds(load)
    planned = gear_after_output_turn(gear, moved[:, None], under)
    for column in range(3):
        turned = moved - (planned - gear)[:, column]
        reached = gear_after_motor_turn(gear, turned, under)[:, column]
        far = np.abs(moved) > STILL_RAD
        np.testing.assert_allclose(reached[far], planned[far, column], atol=1e-15)


@given(gears, loads)
def test_an_output_that_is_not_to_move_stays_where_it_lies_unless_its_load_drags_it(gear, load):
    np.testing.assert_array_equal(
        gear_after_output_turn(gear, np.zeros((5, 1)), bounds(load)),
        gear_after_motor_turn(gear, np.zeros(5), bounds(load)),
    )


def test_the_load_is_known_the_worse_the_more_gravity_there_is():
    np.testing.assert_array_equal(ERROR, CONFIG.load_error_Nm)
    np.testing.assert_allclose(load_error(CONFIG, np.array([0.0, 9.81, 0.0])), ERROR * 9.81 / 3.711)
    np.testing.assert_array_equal(load_error(CONFIG, np.zeros(3)), 0.0)


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


def test_a_run_without_the_way_before_the_stop_or_a_part_of_the_gap_measures_nothing():
    joint, load, gap = Joint.ELEVATION, -5.0, 4e-3
    towards, away = run(joint, load, gap, 1.7e5, 3e5, 60.0, 1)
    press = fit_contact_line(CONFIG, joint, load, towards)
    assert measure_backlash(CONFIG, joint, load, press, away) == pytest.approx(gap, abs=0.12e-3)
    late = Readings(towards.motor_rad[-110:], towards.torque_Nm[-110:])
    assert fit_contact_line(CONFIG, joint, load, late) is None
    for part in (slice(100), slice(150), slice(300, None)):
        some = Readings(away.motor_rad[part], away.torque_Nm[part])
        assert measure_backlash(CONFIG, joint, load, press, some) is None


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
