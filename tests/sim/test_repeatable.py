"""Equal seeds give equal messages at equal times, bit for bit."""

import hashlib
import subprocess
import sys
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsw.dictionary.commands import MoveJoints, Process
from sim.arms import arm_named
from sim.loop import ClosedLoop, Setup
from sim.record import CycleRecord
from sim.sequence import run_sequence
from sim.setting import World
from tests.sim import lab

ROOT = Path(__file__).resolve().parents[2]
GOAL = tuple(float(a) for a in np.radians([0.4, -60.3, 110.5, 129.0, 91.0]))


def start(
    arm_name: str = "as-built:3", seed: int = 1, with_truth: bool = True, roll_rad: float = 0.1
) -> ClosedLoop:
    """Start the loop of a built arm on a rover that is tilted to a side."""
    arm = arm_named(arm_name)
    world = World(tilt_roll_rad=roll_rad)
    setup = Setup(arm, world, arm.params.poses.ready_rad, seed, lab.true_reference(arm))
    return ClosedLoop(setup, with_truth)


def records(arm_name: str = "as-built:3", seed: int = 1) -> list[CycleRecord]:
    """Run a short move of a built arm, and a second at rest."""
    loop = start(arm_name, seed)
    cycles = list(run_sequence(loop, (MoveJoints(GOAL),)))
    return cycles + [loop.cycle() for _ in range(64)]


def bits(value: Any) -> str:
    """Return everything in a record, with every bit of its numbers."""
    if is_dataclass(value):
        inner = ",".join(f"{f.name}={bits(getattr(value, f.name))}" for f in fields(value))
        return f"{type(value).__name__}({inner})"
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}{value.tobytes().hex()}"
    if isinstance(value, tuple):
        return f"({','.join(bits(v) for v in value)})"
    return value.hex() if isinstance(value, float) else repr(value)


def digest(cycles: list[CycleRecord]) -> str:
    return hashlib.sha256("\n".join(bits(c) for c in cycles).encode()).hexdigest()


@pytest.fixture(scope="module")
def first() -> list[CycleRecord]:
    return records()


def test_the_run_is_worth_comparing_and_its_time_is_the_tick_over_the_cycle_rate(first):
    assert len(first) > 150
    assert any(c.outputs.tool is not None for c in first)
    assert sum(len(c.outputs.evrs) for c in first) >= 4
    assert np.ptp([c.truth.output_rad for c in first], axis=0).max() > 0.01
    assert [c.tick for c in first] == list(range(len(first)))
    assert [c.truth.time_s for c in first] == [k / 64 for k in range(len(first))]


def test_the_same_seed_gives_the_same_bits_in_every_cycle(first: list[CycleRecord]) -> None:
    again = records()
    assert len(again) == len(first)
    for one, other in zip(first, again, strict=True):
        assert bits(one) == bits(other), f"tick {one.tick}"


@pytest.mark.slow
def test_another_process_gives_the_same_bits(first: list[CycleRecord]) -> None:
    program = "from tests.sim.test_repeatable import digest, records; print(digest(records()))"
    run = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True, timeout=60
    )
    assert run.stdout.strip() == digest(first)


def test_another_seed_gives_other_noise_on_the_same_arm_and_another_arm_moves_otherwise(first):
    one, other, arm = (run[0] for run in (first, records(seed=2), records("as-built:4")))
    for field in ("resolver_rad", "current_A", "gravity_R_m_s2"):
        assert not np.array_equal(getattr(other.sensors, field), getattr(one.sensors, field))
    np.testing.assert_array_equal(other.truth.p_RoTo_R_m, one.truth.p_RoTo_R_m)
    np.testing.assert_array_equal(other.sensors.encoder_count, one.sensors.encoder_count)
    assert np.abs(arm.truth.p_RoTo_R_m - one.truth.p_RoTo_R_m).max() > 1e-4


def test_asking_for_the_truth_does_not_change_the_run(first):
    for one, other in zip(run_sequence(start(with_truth=False), (MoveJoints(GOAL),)), first, strict=False):
        assert one.truth is None
        assert bits(one.outputs) == bits(other.outputs), f"tick {one.tick}"
        assert bits(one.sensors) == bits(other.sensors), f"tick {one.tick}"


def test_a_software_error_ends_with_the_brakes_holding_and_nothing_after_it(monkeypatch):
    """After an exception the power is off at once, and the plant goes on until the brakes hold."""
    loop = start("nominal")
    loop.cycle((MoveJoints((0.1,) * 5, relative=True),))
    for _ in range(64):
        loop.cycle()
    assert not loop.plant.data.eq_active[loop.plant.at.brake].any()

    def broken(*_):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("sim.loop.step", broken)
    record = loop.cycle()
    assert [evr.name for evr in record.outputs.evrs] == ["SoftwareError"]
    assert not record.outputs.joint.busy
    assert loop.plant.data.eq_active[loop.plant.at.brake].all()
    with pytest.raises(RuntimeError, match="ended"):
        loop.cycle()


def test_a_run_that_vibrates_has_the_same_bits_whether_its_truth_is_read_or_not() -> None:
    ends = []
    for with_truth in (False, True):
        loop = start("nominal", with_truth=with_truth, roll_rad=0.0)
        shake = run_sequence(loop, (Process("portion", (-0.02, 0.0, -1.0), 1.0),))
        assert sum(record.outputs.drive.vibrate for record in shake) > 0
        ends.append(loop.plant.data.qpos.tobytes())
    assert ends[0] == ends[1]
