"""Tests of bounded work: how much one cycle does, and what becomes of cycles that are missed meanwhile.

Work is counted in calls of functions, which the load of the machine does not change.
"""

import sys
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from fsw.config import CYCLE_S
from fsw.cycle import step
from fsw.dictionary.commands import MoveJoints
from fsw.dictionary.evrs import CommandRefused, CyclesSkipped
from sim.arms import arm_named
from sim.initialisation import true_reference
from sim.loop import ClosedLoop, Setup
from sim.placement import Placement, PlacementRun
from sim.sequence import Outcome, SequenceRun
from sim.setting import Surface, World
from validation.benchmarks import describe_cycles
from validation.cycle_time import (
    MOST_MEDIANS,
    PLAIN_SHARE,
    LateLoop,
    hooked_step,
    report,
    summarize_times,
    time_run,
    times_to_motion,
)

ARM = arm_named("nominal")
CLEAR = Placement("apxs", (2.05, 0.1, -0.25), (-0.5, 0.1, -0.85))
BLOCKED = Placement("mahli", (2.0, -0.2, -0.32), (-0.96, -0.16, -0.24))
"""Placement at which every branch leads the arm into the rock."""
TURNS = tuple(MoveJoints((turn_rad, 0.0, 0.0, 0.0, 0.0), relative=True) for turn_rad in (0.01, -0.01))


def setup(placement: Placement) -> Setup:
    """Return the setup in front of a target, with the arm in the ready pose."""
    world = World(surface=Surface(placement.p_N_m, placement.normal_N))
    return Setup(ARM, world, ARM.params.poses.ready_rad, 0, true_reference(ARM))


def counted_step(calls: list[int], *arguments):
    """Run `fsw.cycle.step`, and append the number of calls of functions that it makes."""
    count = 0

    def note_call(_frame, event, _argument):
        nonlocal count
        count += event in ("call", "c_call")

    before = sys.getprofile()
    sys.setprofile(note_call)
    try:
        return step(*arguments)
    finally:
        sys.setprofile(before)
        calls.append(count)


@cache
def plain_calls() -> float:
    """Return the calls of a plain cycle: the median of two short turns."""
    calls: list[int] = []
    with hooked_step(partial(counted_step, calls)):
        for _ in SequenceRun(ClosedLoop(setup(CLEAR)), TURNS):
            pass
    return float(np.median(calls))


@cache
def placed_late(placement: Placement) -> tuple[PlacementRun, tuple[int, ...]]:
    """Place on a clock that does not wait; return the run, and the calls of each cycle."""
    calls, plain = list[int](), plain_calls()
    with hooked_step(partial(counted_step, calls)):
        loop = LateLoop(setup(placement), lambda: PLAIN_SHARE * calls[-1] / plain)
        run = PlacementRun(loop, placement)
        for _ in run:
            pass
    return run, tuple(calls)


def test_a_placement_is_done_although_cycles_are_missed_while_it_is_planned():
    run, _ = placed_late(CLEAR)
    assert run.outcome is Outcome.DONE, run.evrs[-1]


@pytest.mark.parametrize("placement", [CLEAR, BLOCKED], ids=["accepted", "refused"])
def test_no_cycle_does_the_work_of_more_than_sixty_plain_ones(placement):
    _, calls = placed_late(placement)
    assert max(calls) <= MOST_MEDIANS * plain_calls()


def test_a_blocked_placement_is_refused_late_too():
    run, _ = placed_late(BLOCKED)
    assert run.outcome is Outcome.REFUSED
    assert any(isinstance(evr, CommandRefused) for _, evr in run.evrs)


def test_a_cycle_that_takes_more_than_two_periods_misses_two():
    periods = iter((0.1, 2.1, 1.0, 0.1))
    loop = LateLoop(setup(CLEAR), lambda: next(periods))
    records = [loop.cycle() for _ in range(4)]
    assert np.diff([one.sensors.cycle for one in records]).tolist() == [1, 3, 1]
    assert records[2].outputs.evrs == (CyclesSkipped(2),)


@cache
def timed():
    """Time two short turns."""
    return time_run(ClosedLoop(setup(CLEAR)), partial(SequenceRun, commands=TURNS))


def test_the_least_time_of_three_equal_runs_counts_for_each_cycle():
    run = timed()
    assert run.outcome is Outcome.DONE
    assert run.times_ns.shape == (len(run.notes),)
    assert (run.times_ns > 0).all()


def test_runs_that_differ_are_not_compared():
    turns = iter(TURNS)
    with pytest.raises(RuntimeError, match="two runs of the same start differ, at first in cycle "):
        time_run(ClosedLoop(setup(CLEAR)), lambda loop: SequenceRun(loop, (next(turns),)))


def test_the_time_from_a_command_to_its_motion_is_told():
    run = timed()
    to_motion_s = times_to_motion(run.notes)
    assert len(to_motion_s) == len(TURNS)
    first = next(k for k, note in enumerate(run.notes) if note.is_moving)
    assert to_motion_s[0] == first * CYCLE_S


def test_a_long_cycle_is_told_with_its_command_and_is_out_of_bounds():
    run = timed()
    plain = replace(run, times_ns=np.full(len(run.notes), 50_000))
    times_ns = plain.times_ns.copy()
    times_ns[0] *= 61
    assert report([summarize_times("a run", [plain])])["in_bounds"]
    found = report([summarize_times("a run", [replace(run, times_ns=times_ns)])])
    assert not found["in_bounds"]
    assert found["above"] == {"10 medians": 1, "30 medians": 1, "60 medians": 1}
    assert found["largest_in"].startswith("a run: 61 medians, 3.0 ms: ")
    assert "0 cycles after MoveJoints" in found["largest_in"]


def test_a_placement_that_fails_late_is_out_of_bounds():
    run = timed()
    plain = replace(run, times_ns=np.full(len(run.notes), 50_000))
    assert not report([summarize_times("placements, nominal", [plain], ["apxs, seed 1: missed"])])[
        "in_bounds"
    ]


def test_a_run_without_a_command_has_no_time_to_motion():
    run = time_run(ClosedLoop(setup(CLEAR)), lambda loop: SequenceRun(loop, ()))
    assert times_to_motion(run.notes) == []


def test_the_histogram_of_cycle_times_counts_every_cycle():
    found = describe_cycles(np.array([1, 20_000, 20_000, 40_000, 40_000, 40_000, 130_000, 2_000_000_000]))
    assert found["histogram"]["edges_us"][:4] == [16.0, 32.0, 64.0, 128.0]
    assert found["histogram"]["cycles"] == [3, 3, 0, 1, *11 * [0], 1]
    assert found["largest_over_median"] == 2_000_000.0 / 40.0
    bars = list(found["bars"].items())
    assert bars[0] == ("     16 to      32 us", "      3 ######")
    assert bars[2] == ("     64 to     128 us", "      0")
