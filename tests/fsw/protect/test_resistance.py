"""Resistance in a free move: what an obstacle does to currents and gears, and what does so without one."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.config import CYCLE_S
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.faults import UnexpectedContact
from fsw.kinematics.chain import forward, joint_jacobian, tool_pose
from fsw.protect import resistance
from fsw.protect.inputs import CURRENT_GAIN, UPDATE_CYCLES, WIND_UP_UPDATES, compute_bounds
from helpers.marks import slow_but
from tests.fsw.protect.lab import (
    BOUNDS,
    CONFIG,
    JOINTS,
    MONITORS,
    PARAMS,
    READY,
    STIFFNESS,
    WOUND_RAD,
    ZERO,
    a_move,
    at,
    moving,
)

RATE = 0.5 * CONFIG.speed_rad_s
KNOWN = 4 * UPDATE_CYCLES * resistance.LEAST_UPDATES
"""Cycles after which all means are known."""
FRESH = (0,) * 13
CONSTANT = CONFIG.torque_constant_Nm_A
joints = pytest.mark.parametrize("joint", Joint)
directions = pytest.mark.parametrize("sign", [-1.0, 1.0])


class Turning:
    """Arm that turns at a constant rate, and the monitor of its move."""

    def __init__(self, rate_rad_s=RATE, seed=None, bounds=BOUNDS, **changes):
        self.rate, self.bounds, self.changes = np.asarray(rate_rad_s, float), bounds, changes
        self.state, self.cycles, self.angle = None, 0, READY
        self.noise = None if seed is None else np.random.default_rng(seed)
        self.resolver = np.zeros(5)

    def cycle(self, torque_Nm=ZERO, wound_rad=ZERO, unchanged=FRESH, move=None, **changes):
        """Run a cycle with torques of an obstacle on the outputs; return what was found."""
        self.cycles += 1
        self.angle = self.angle + self.rate * CYCLE_S
        current, error = -np.asarray(torque_Nm) / CONSTANT, np.asarray(wound_rad, float)
        if self.noise is not None:
            current = current + MONITORS.current_noise_A * self.noise.standard_normal(5)
            error = error + MONITORS.resolver_noise_rad * self.noise.standard_normal(5)
        self.resolver = self.resolver + (error - self.resolver) / 16
        arm = moving(
            move or a_move(setpoint_rad=self.angle, setpoint_rate_rad_s=self.rate),
            motor_rad=self.angle,
            motor_rate_rad_s=self.rate,
            resolver_error_rad=self.resolver,
            **(self.changes | changes),
        )
        resolver = self.angle + arm.gear_rad + error
        readings = (*resolver.tolist(), *current.tolist(), *MARS)
        self.state, found = resistance.monitor_free_move(self.bounds, self.state, arm, readings, unchanged)
        return found

    def until_found(self, cycles, **readings):
        """Return the first event in so many cycles, and the number of its cycle; None if there is none."""
        for k in range(cycles):
            found = self.cycle(**readings)
            if found:
                return found[0], k + 1
        return None, cycles


MARS = (0.0, 0.0, 3.711)


def known(**kwargs):
    """An arm whose means are known."""
    turning = Turning(**kwargs)
    assert turning.until_found(KNOWN) == (None, KNOWN)
    return turning


def least_torque_Nm(joint):
    """Torque of one joint that passes the bound for long, with the most readings in its mean."""
    rate_step = 0.02 if joint < Joint.WRIST else 0.04
    assert JOINTS[joint].jerk_rad_s3 == rate_step
    slack_Nm = JOINTS[joint].damping_Nms_rad * JOINTS[joint].jerk_rad_s3 * (UPDATE_CYCLES * CYCLE_S) ** 2
    return np.sqrt(resistance.CONTACT) * BOUNDS.current_sigma_A[-1] * CONSTANT[joint] + slack_Nm


@joints
@directions
def test_a_torque_against_the_motion_is_a_contact_of_that_joint(joint, sign):
    turning = known(rate_rad_s=sign * RATE)
    torque = 2.0 * least_torque_Nm(joint)
    event, cycle = turning.until_found(10, torque_Nm=at(joint, -sign * torque))
    assert isinstance(event, UnexpectedContact)
    assert event.joint is joint
    assert 0.5 * torque <= event.torque_Nm <= torque
    assert cycle <= 4


@joints
def test_a_torque_with_the_motion_is_none(joint):
    assert known().until_found(200, torque_Nm=at(joint, 5.0 * least_torque_Nm(joint)))[0] is None


@joints
def test_a_torque_just_below_the_bound_is_none_and_one_just_above_is(joint):
    bound = least_torque_Nm(joint)
    assert known().until_found(6, torque_Nm=at(joint, -0.9 * bound))[0] is None
    assert known().until_found(12, torque_Nm=at(joint, -1.3 * bound))[0] is not None


def test_torques_of_several_joints_add_up_in_squares():
    bound = np.array([least_torque_Nm(joint) for joint in Joint])
    assert known().until_found(12, torque_Nm=-0.8 * bound)[0] is not None


def test_the_force_is_that_which_explains_the_torques_along_the_motion_of_the_tool():
    turning = known()
    frames = forward(CONFIG.arm, turning.angle + WOUND_RAD)
    J = joint_jacobian(frames, tool_pose(CONFIG.arm, frames, "apxs").p)[3:]
    way = J @ RATE / np.linalg.norm(J @ RATE)
    event, cycle = turning.until_found(20, torque_Nm=-100.0 * J.T @ way)
    seen = 1.0 - (1.0 - CURRENT_GAIN) ** cycle
    assert event.force_N == pytest.approx(100.0 * seen, rel=0.1)


@pytest.mark.parametrize("seed", slow_but(range(4), 0))
def test_noise_alone_is_no_contact(seed):
    assert Turning(seed=seed).until_found(10_000)[0] is None


def test_the_bound_follows_the_noise_of_the_parameters():
    quiet = compute_bounds(
        replace(PARAMS, monitors=replace(MONITORS, current_noise_A=0.01)), CONFIG.arm, CYCLE_S
    )
    np.testing.assert_allclose(np.array(BOUNDS.current_sigma_A) / quiet.current_sigma_A, 2.0)
    assert min(np.diff(BOUNDS.current_sigma_A)) < 0.0


@joints
def test_wind_up_of_a_joint_on_its_brake_is_a_contact_within_a_second(joint):
    turning = known(rate_rad_s=ZERO)
    wound = 40.0 / STIFFNESS[joint]
    event, _ = turning.until_found(64, wound_rad=at(joint, wound))
    assert event.joint is joint
    assert 10.0 < event.torque_Nm < 40.0


def test_wind_up_is_a_contact_only_beyond_the_uncertainty_of_the_gear():
    unsure = known(rate_rad_s=ZERO, gear_uncertainty_rad=np.full(5, 1e-3))
    assert unsure.until_found(200, wound_rad=at(Joint.ELBOW, 1e-3))[0] is None


def test_a_joint_that_takes_up_its_backlash_shows_nothing():
    off = {"gear_lowest_rad": WOUND_RAD - 1e-3, "gear_highest_rad": WOUND_RAD + 1e-3}
    turning = Turning()
    assert turning.until_found(KNOWN, **off)[0] is None
    assert turning.until_found(10, torque_Nm=np.full(5, -100.0), **off)[0] is None


def test_a_reading_that_jumps_is_a_sensor():
    turning = known()
    assert turning.until_found(400, torque_Nm=at(Joint.ELBOW, -1000.0))[0] is None
    noisy = known()
    for sign in (-1, 1) * 200:
        assert not noisy.cycle(torque_Nm=at(Joint.ELBOW, 300.0 * sign))


@pytest.mark.parametrize("jumps", [False, True])
def test_a_reading_that_jumps_hides_only_its_own_joint(jumps):
    turning, torque = known(), at(Joint.ELEVATION, -2.0 * least_torque_Nm(Joint.ELEVATION))
    found = [
        turning.cycle(torque_Nm=torque + at(Joint.WRIST, 1000.0 if jumps and cycle == 2 else 0.0))
        for cycle in range(4)
    ]
    assert [len(events) for events in found] == [0, 0, 0, 1]
    assert found[3][0].joint is Joint.ELEVATION


def test_a_frozen_resolver_shows_nothing():
    frozen = (1, *FRESH[1:])
    turning = known(rate_rad_s=ZERO)
    assert turning.until_found(200, wound_rad=at(Joint.AZIMUTH, 1e-3), unchanged=frozen)[0] is None


def test_a_torque_that_rises_as_slowly_as_a_load_is_none():
    turning = known()
    for cycle in range(64):
        assert not turning.cycle(torque_Nm=at(Joint.ELEVATION, -2.6 * cycle * CYCLE_S))


def test_vibration_of_the_arm_is_none():
    turning = known()
    swing_Nm = at(Joint.ELEVATION, 11.0) + at(Joint.ELBOW, 7.0)
    for cycle in range(200):
        assert not turning.cycle(torque_Nm=swing_Nm * np.sin(2 * np.pi * 2.0 * cycle * CYCLE_S))


def test_friction_that_grows_with_speed_is_none():
    turning = Turning(rate_rad_s=0.02 * RATE)
    damping = np.array([joint.damping_Nms_rad for joint in JOINTS])
    for _ in range(200):
        turning.rate = np.minimum(turning.rate + CONFIG.acceleration_rad_s2 * CYCLE_S, CONFIG.speed_rad_s)
        assert not turning.cycle(torque_Nm=-damping * turning.rate)


@pytest.mark.parametrize(
    "other",
    [
        {"mode": Mode.RETRACTING},
        {"move": a_move(is_stopping=True)},
        {"move": a_move(is_releasing=True)},
        {"move": a_move(homing=Joint.ELBOW)},
    ],
)
def test_only_a_free_move_is_monitored(other):
    arm = moving(other.get("move", a_move()), other.get("mode", Mode.FREE_SPACE))
    assert resistance.monitor_free_move(BOUNDS, None, arm, (0.0,) * 13, FRESH) == (None, ())


OLD = resistance.JointMeans(2, 0.1, 0.01, 20, 1e-4, 0.0, 0.01, 1e-4, 1.0)
FOLLOWS = {"wind_up_updates": 21, "wind_up_share": 1 / 21}
ANEW = {"wind_up_updates": 0, "wind_up_share": 1.0}


@pytest.mark.parametrize(
    ("was", "rate", "sigmas", "side", "current", "wind_up"),
    [
        ({}, 0.02, 2.0, 1.0, True, FOLLOWS),
        ({"rate_rad_s": -0.01, "last_rate_rad_s": -0.01}, -0.02, -2.0, 1.0, True, FOLLOWS),
        ({"last_rate_rad_s": -0.01}, 0.02, 2.0, 1.0, False, FOLLOWS),
        ({}, 0.02, 4.0, 1.0, True, ANEW),
        ({}, 0.02, -4.0, 1.0, True, FOLLOWS),
        ({"wind_up_updates": 5}, 0.02, -4.0, 1.0, True, ANEW),
        ({"last_side": 0.0}, 0.02, 2.0, 0.0, True, ANEW),
        ({}, 0.02, 2.0, -1.0, True, ANEW),
        ({"wind_up_updates": WIND_UP_UPDATES}, 0.02, 2.0, 1.0, True,
         {"wind_up_updates": WIND_UP_UPDATES, "wind_up_share": 1 / WIND_UP_UPDATES}),
    ],
)  # fmt: skip
def test_slow_means_follow_or_begin_anew(was, rate, sigmas, side, current, wind_up):
    last = OLD._replace(**was)
    off = sigmas * BOUNDS.wind_up_sigma_rad[last.wind_up_updates]
    motor, wound = rate / BOUNDS.updates_Hz, last.wind_up_rad + off
    dragged = {f"gear_{'lowest' if rate > 0 else 'highest'}_rad": WOUND_RAD}
    loose = {"gear_lowest_rad": WOUND_RAD - 1.0, "gear_highest_rad": WOUND_RAD + 1.0} | dragged
    arm = moving(
        motor_rad=np.full(5, motor), resolver_error_rad=np.full(5, wound), side=np.full(5, side), **loose
    )
    now = resistance.FreeMove(
        UPDATE_CYCLES, (), (0.7,) * 5, resistance.NOTHING, resistance.NOTHING, (last,) * 5, ()
    )
    friction_A, rate_rad_s = 0.1 + (0.7 - 0.2 - 0.1) / 3, (2 * last.rate_rad_s + rate) / 3
    mean = {"updates": 3, "friction_A": friction_A, "rate_rad_s": rate_rad_s}
    expected = resistance.JointMeans(
        **(mean if current else {}),
        wind_up_updates=wind_up["wind_up_updates"],
        wind_up_rad=last.wind_up_rad + off * wind_up["wind_up_share"],
        last_motor_rad=motor,
        last_rate_rad_s=rate,
        last_wind_up_rad=wound,
        last_side=side,
    )
    for one in resistance.update_means(BOUNDS, now, arm, [0.2] * 5, FRESH):
        assert one == pytest.approx(expected)


def test_a_gear_takes_a_current_only_beyond_its_backlash():
    gear = CONFIG.half_backlash_rad * np.array([0.5, -0.5, 1.0, 1.0, -1.0]) + [0.0, 0.0, 0.01, 0.02, -0.01]
    load_A = resistance.compute_load_current(BOUNDS, moving(gear_rad=gear))
    np.testing.assert_allclose(load_A, STIFFNESS / CONSTANT * [0.0, 0.0, -0.01, -0.02, 0.01], atol=1e-12)


def test_a_current_is_expected_once_its_mean_is_known():
    mean = resistance.JointMeans(resistance.LEAST_UPDATES, 0.1, 0.01, last_rate_rad_s=0.02)
    means = (mean, mean._replace(last_rate_rad_s=-0.02), mean._replace(updates=resistance.LEAST_UPDATES - 1))
    expected_A, per_A = resistance.expect_currents(BOUNDS, means, [0.2, 0.3, 0.4])
    per = 1.0 / BOUNDS.current_sigma_A[resistance.LEAST_UPDATES]
    assert (expected_A, per_A) == (pytest.approx((0.3, 0.4, 0.5)), (per, -per, 0.0))


@pytest.mark.parametrize("side", [0.0, 1.0])
def test_the_slack_of_a_current_is_that_of_friction_and_of_the_load_on_an_uncertain_side(side):
    means = (resistance.JointMeans(rate_rad_s=0.01, last_rate_rad_s=0.03, last_side=side),) * 5
    slack_A = 0.04 * np.array(BOUNDS.damping_As_rad) + BOUNDS.steady_A
    if side == 0.0:
        slack_A += BOUNDS.load_error_A
    np.testing.assert_allclose(resistance.compute_slack(BOUNDS, means), slack_A)


@pytest.mark.parametrize(
    ("more", "rate", "share", "found"),
    [
        (1, -1.0, 1.0, True),
        (1, 1.0, 1.0, False),
        (0, -1.0, 1.0, False),
        (1, -1.0, 0.51, True),
        (1, -1.0, 0.49, False),
    ],
)
def test_a_wind_up_is_a_contact_against_the_motion_once_it_is_known_and_if_the_last_readings_show_half_of_it(
    more, rate, share, found
):
    means = (resistance.JointMeans(wind_up_updates=resistance.LEAST_WIND_UP_UPDATES + more),) * 5
    now = tuple(one._replace(last_wind_up_rad=1e-3) for one in means)
    read = (*ZERO.tolist(), *(WOUND_RAD + share * 1e-3).tolist())
    before = resistance.FreeMove(0, read, (), (), (), means, (read,) * resistance.RECENT)
    move = a_move(setpoint_rate_rad_s=np.full(5, rate * 1e-3))
    (*events,) = resistance.check_wind_up(BOUNDS, before, now, moving(move), move)
    assert bool(events) is found
    assert all(event.torque_Nm == pytest.approx(1e-3 * STIFFNESS[event.joint]) for event in events)


def test_bounds_follow_from_noise_encoders_and_stiffness():
    quiet = 6.0 * np.sqrt(2.0)
    jumps = (
        quiet * MONITORS.current_noise_A + STIFFNESS / CONSTANT * CONFIG.speed_rad_s / 64,
        quiet * MONITORS.resolver_noise_rad + CONFIG.speed_rad_s / 64,
    )
    np.testing.assert_allclose(BOUNDS.reading_step, np.concatenate(jumps))
    counts = [joint.encoder_counts_per_turn * joint.gear_ratio for joint in JOINTS]
    np.testing.assert_allclose(BOUNDS.turning_rad_s, 64 * 2 * np.pi / np.array(counts))
    assert BOUNDS.updates_Hz == 8.0
    for sigma, noise, fast, most in (
        (BOUNDS.current_sigma_A, MONITORS.current_noise_A, 1 / 7, 8),
        (BOUNDS.wind_up_sigma_rad, MONITORS.resolver_noise_rad, 1 / 31, 32),
    ):
        updates = np.maximum(np.arange(most + 1), 1)
        np.testing.assert_allclose(sigma, noise * np.sqrt(fast + 1 / (8 * updates)))
    for bound, name in ((BOUNDS.load_error_A, "load_error_Nm"), (BOUNDS.damping_As_rad, "damping_Nms_rad")):
        np.testing.assert_allclose(bound * CONSTANT, [getattr(joint, name) for joint in JOINTS])
