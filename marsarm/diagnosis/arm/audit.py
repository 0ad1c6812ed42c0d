"""Audit of recordings before a diagnosis: reasons to refuse them, and notes on anomalies.

`refusals` finds errors that prevent a comparison with the simulator. `audit_recordings` finds anomalies that
a user should know: stale or saturated sensors, wrong units, and missing motion.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Joint
from fsw.dictionary.params import Params, digest
from marsarm.diagnosis.arm.logs import NotForDiagnosis, Recording, find_rests, find_segments, load_recording
from sim.arm_model.load import ArmModel
from simgap.checks.records import runs
from simgap.common.console import pluralize
from simgap.report.sentences import join_words

CONTINUOUS: Final = ("resolver_rad", "current_A", "gravity_R_m_s2")
STALE_TICKS: Final = CYCLE_HZ
"""Time in ticks for which a working noisy sensor, or the encoder of a driven joint, does not stay
constant."""
CLIPPED_TICKS: Final = 4
"""Number of readings at one extreme that counts as saturation."""
RESOLVER_TOLERANCE_RAD: Final = 0.2
"""Greatest median difference of resolver and encoder if both have the right unit and zero."""
PLAUSIBLE_GRAVITY_M_S2: Final = (1.0, 12.0)
"""Range of gravity on Mars and on Earth."""
MIN_SEGMENTS: Final = 2
"""Least number of motions of a joint, one each way."""


def refusals(recordings: Sequence[Recording], base: Params) -> tuple[str, ...]:
    """Return the reasons why recordings cannot be compared with a simulator of these parameters."""
    known = recordings[0].arm.name
    foreign = {one.params.model.name for one in recordings} - {known}
    if foreign:
        names = ", ".join(sorted(foreign))
        return (f"logs of the arm {names}, and the diagnosis is of the arm {known}: name theirs with --arm",)
    wrong = [
        f"{one.name}: {reason}"
        for one in recordings
        for reason in (*_not_finite(one.sensors), *_not_finite(one.drive), *_time_base(one))
    ]
    others = [one.name for one in recordings if digest(one.params) != digest(base)]
    if others:
        wrong.append(
            f"{len(others)} of {len(recordings)} logs were made with other flight parameters than those "
            f"of the diagnosis ({digest(base)[:12]}): {join_words(others, 'and')}; "
            "diagnose logs of one arm with its parameters"
        )
    return tuple(wrong)


def load_checked_recordings(
    paths: Sequence[Path], base: Params | None = None, arm: ArmModel | None = None
) -> list[Recording]:
    """Load recordings, and check that a simulator of these parameters and drawing can be compared with them.

    By default the parameters are those of the first log. NotForDiagnosis says why a log cannot be compared.
    """
    recordings = [load_recording(path, arm) for path in paths]
    wrong = refusals(recordings, base or recordings[0].params) if recordings else ()
    if wrong:
        raise NotForDiagnosis("\n".join(wrong))
    return recordings


def find_missing_motion(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return what is missing if neither actuators nor links and frames can be diagnosed; else nothing."""
    if any(_motions(recordings).values()) or any(map(_shows_links, recordings)):
        return ()
    return tuple(_audit_campaign(recordings))


def _shows_links(recording: Recording) -> bool:
    return bool(recording.tracker_poses.tick.size) and recording.world.surface is None


def audit_recordings(recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return notes on each recording, and on the campaign as a whole."""
    found = [f"{one.name}: {note}" for one in recordings for note in find_anomalies(one)]
    return (*found, *_audit_campaign(recordings))


def find_anomalies(recording: Recording) -> Iterator[str]:
    """Yield the anomalies of one recording."""
    yield from recording.notes
    for find in (_stale, _clipped, _units, _unused):
        yield from find(recording)


def _not_finite(columns: Mapping[str, NDArray[Any]]) -> Iterator[str]:
    for name, values in columns.items():
        rows = ~np.isfinite(np.asarray(values, float)).reshape(len(values), -1)
        if rows.any():
            first = int(np.flatnonzero(rows.any(axis=1))[0])
            yield (
                f"{name} is not a number {int(rows.sum())} times, first at {first / CYCLE_HZ:.2f} s; "
                f"remove the recording, or cut it before that time"
            )


def _time_base(recording: Recording) -> Iterator[str]:
    steps = np.diff(recording.sensors["cycle"])
    gaps = np.flatnonzero(steps != 1)
    if gaps.size:
        lost = int(np.sum(np.maximum(steps[gaps] - 1, 0)))
        yield (
            f"the avionics' count of cycles jumps {gaps.size} times, first at {gaps[0] / CYCLE_HZ:.2f} s "
            f"({lost} cycles are missing): the commands in between are unknown"
        )


def _stale(recording: Recording) -> Iterator[str]:
    for name in CONTINUOUS:
        for k, column in enumerate(recording.sensors[name].T):
            same = runs(np.diff(column) == 0)
            at, end = max(same, key=lambda one: one[1] - one[0], default=(0, 0))
            longest = end - at + 1
            if longest >= STALE_TICKS and not (name == "current_A" and not column[at]):
                yield (
                    f"{name}[{k}] reads {column[at]:g} for {longest / CYCLE_HZ:.1f} s from "
                    f"{at / CYCLE_HZ:.2f} s on: it is stale"
                )
    for segment in find_segments(recording):
        counts = recording.sensors["encoder_count"][segment.first : segment.end, segment.joint]
        commanded = recording.drive["setpoint_count"][segment.first : segment.end, segment.joint]
        if np.ptp(counts) == 0 and np.ptp(commanded) > 0:
            yield (
                f"encoder_count[{int(segment.joint)}] does not move from {segment.first / CYCLE_HZ:.2f} s on "
                f"while {segment.joint.name.lower()} is driven"
            )


def _clipped(recording: Recording) -> Iterator[str]:
    limit_A, current_A = recording.drive["current_limit_A"], np.abs(recording.sensors["current_A"])
    for joint in Joint:
        most_A = float(current_A[:, joint].max())
        at = np.flatnonzero(current_A[:, joint] >= np.minimum(most_A, 0.99 * limit_A[:, joint]))
        if most_A > 0 and at.size >= CLIPPED_TICKS:
            yield (
                f"current_A[{int(joint)}] is at its limit or saturated {at.size} times, first at "
                f"{at[0] / CYCLE_HZ:.2f} s: it reads {most_A:g} A and never more"
            )


def _units(recording: Recording) -> Iterator[str]:
    offset_rad = np.median(recording.sensors["resolver_rad"].T - recording.motor_rad(), axis=1)
    for joint in Joint:
        if abs(offset_rad[joint]) > RESOLVER_TOLERANCE_RAD:
            yield (
                f"{joint.name.lower()}: resolver and encoder are {offset_rad[joint]:.3g} rad apart; one is "
                f"in another unit, has another sign, or the zeros are of another arm"
            )
    strength = float(np.median(np.linalg.norm(recording.sensors["gravity_R_m_s2"], axis=1)))
    if not PLAUSIBLE_GRAVITY_M_S2[0] < strength < PLAUSIBLE_GRAVITY_M_S2[1]:
        yield f"gravity_R_m_s2 is {strength:.3g} long; m/s^2 are wanted"


def _unused(recording: Recording) -> Iterator[str]:
    """Report tracker poses that are of no rest, or not the last of it; nothing is compared with them."""
    ticks = recording.tracker_poses.tick
    odd = ticks[~np.isin(ticks, find_rests(recording))]
    if odd.size:
        yield (
            f"{odd.size} of {ticks.size} tracker poses, that of tick {odd[0]} first, are not the last of a "
            f"rest of half a second or more, and are not used"
        )


def _audit_campaign(recordings: Sequence[Recording]) -> Iterator[str]:
    for joint, count in _motions(recordings).items():
        if count < MIN_SEGMENTS:
            yield (
                f"{joint.name.lower()} has {pluralize(count, 'motion')}; without {MIN_SEGMENTS}, "
                f"one each way, its actuator cannot be diagnosed"
            )
    if not any(map(_shows_links, recordings)):
        yield "no recording has tracker poses (NAME.tracker.csv): links and frames cannot be diagnosed"
    if not any(find_rests(one) for one in recordings):
        yield "the arm never rests for half a second: rests cannot be compared"
    names = [one.block for one in recordings]
    if len(set(names)) == 1:
        yield "there is only one motion: its explanation cannot be tested on another"
    if len(set(names)) == len(names):
        yield "no motion was repeated: the noise floor is assumed to be that of the nominal sensors"


def _motions(recordings: Sequence[Recording]) -> Counter[Joint]:
    """Count the motions of each joint."""
    count = Counter(dict.fromkeys(Joint, 0))
    count.update(segment.joint for one in recordings for segment in find_segments(one))
    return count
