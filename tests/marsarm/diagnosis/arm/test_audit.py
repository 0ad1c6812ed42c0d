"""The audit notes errors of a recording, and nothing about a good one."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from marsarm.diagnosis.arm.audit import audit_recordings, find_anomalies, find_missing_motion, refusals
from marsarm.diagnosis.arm.logs import Recording, world_from_imu
from sim.arms import arm_named, nominal_params
from sim.setting import World

BASE = nominal_params()


def with_sensor_error(recording: Recording, name: str, change: Callable[[np.ndarray], None]) -> Recording:
    values = np.array(recording.sensors[name])
    change(values)
    return replace(recording, sensors={**recording.sensors, name: values})


def nan(values: np.ndarray) -> None:
    values[100, 2] = np.nan


def stale(values: np.ndarray) -> None:
    values[100:250, 2] = values[100, 2]


def jumps(values: np.ndarray) -> None:
    values[100:] += 5


def degrees(values: np.ndarray) -> None:
    values *= 180 / np.pi


def flat(values: np.ndarray) -> None:
    np.clip(values, -0.01, 0.01, out=values)


def test_a_good_recording_is_passed_over_in_silence(recordings: list[Recording]) -> None:
    for one in recordings:
        assert list(find_anomalies(one)) == []


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("resolver_rad", stale, "is stale"),
        ("resolver_rad", degrees, "another unit"),
        ("current_A", flat, "saturated"),
        ("gravity_R_m_s2", degrees, "m/s^2 are wanted"),
    ],
)
def test_an_anomaly_is_noted(
    recordings: list[Recording], name: str, change: Callable[[np.ndarray], None], words: str
) -> None:
    assert any(words in note for note in find_anomalies(with_sensor_error(recordings[0], name, change)))


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("current_A", nan, "is not a number 1 times, first at 1.56 s"),
        ("cycle", jumps, "5 cycles are missing"),
    ],
)
def test_what_cannot_be_compared_is_refused(
    recordings: list[Recording], name: str, change: Callable[[np.ndarray], None], words: str
) -> None:
    assert not refusals(recordings, BASE)
    assert any(words in note for note in refusals([with_sensor_error(recordings[0], name, change)], BASE))


def test_a_campaign_that_is_too_small_is_noted(recordings: list[Recording]) -> None:
    said = audit_recordings(recordings[:1])
    assert any("moves 1 times" in sentence for sentence in said)
    assert any("no motion was repeated" in sentence for sentence in said)
    assert not any("no motion was repeated" in sentence for sentence in audit_recordings(recordings))


def test_logs_in_which_nothing_moves_are_too_little(recordings: list[Recording]) -> None:
    drive = recordings[2].drive
    still = replace(recordings[2], drive={**drive, "power_on": np.zeros_like(drive["power_on"])})
    assert any("wrist moves 0 times" in sentence for sentence in find_missing_motion([still]))
    assert find_missing_motion([still, recordings[0]]) == ()
    assert find_missing_motion(recordings[2:]) == ()


def test_recordings_of_other_parameters_or_another_drawing_are_refused_once(
    recordings: list[Recording],
) -> None:
    (sentence,) = refusals(recordings, arm_named("calibrated:1").params)
    assert sentence.startswith("3 of 3 logs were made with other flight parameters")
    foreign = [replace(one, params=arm_named("m2020").params) for one in recordings]
    (sentence,) = refusals(foreign, BASE)
    assert sentence.startswith("logs of the arm m2020, and the diagnosis is of the arm msl")


@pytest.mark.parametrize("scene", ["mars", "earth"])
def test_the_imu_tells_scene_and_tilt_of_a_log_that_does_not(scene: Literal["mars", "earth"]) -> None:
    tilted = World(scene, 0.3, -0.2)
    seen = world_from_imu(tilted.gravity_N_m_s2, Path("a.mcap"))
    np.testing.assert_allclose(seen.gravity_N_m_s2, tilted.gravity_N_m_s2, atol=1e-12)
    assert (seen.tilt_roll_rad, seen.tilt_pitch_rad) == pytest.approx((0.3, -0.2))
