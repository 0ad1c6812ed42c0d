"""Judgement of the readings, the first stage of a cycle: no state takes a value that cannot be.

Each number of a reading is judged by its range, and by its change since readings that were used: what a motor
can turn in a cycle, a resolver behind a backlash, the heat of a winding, a rover. A number that is not
plausible is not used. The last one that was used takes its place; a motor that turned goes on as it turned,
at its commanded rate at most. The number is counted and told, and is a fault once it has lasted for its
persistence. `docs/faults.md` derives the bounds.

A wrong number within its bounds is used. So that the right one after it does not look wild, a number is
plausible if it can follow either of the last two that were used.

The first readings have no history. They are used, because brakes are on, and are confirmed by the next ones.
If these contradict them, both history and estimate begin anew.
"""

from dataclasses import dataclass, replace
from math import dist, hypot, inf
from operator import le, sub
from typing import Final

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import CyclesSkipped, Evr, ReadingNotUsed
from fsw.dictionary.faults import CycleCountWrong, CyclesMissed, ReadingImplausible
from fsw.dictionary.params import Params
from fsw.dictionary.types import cycle_record
from fsw.kinematics.transforms import Flags
from fsw.messages import ActuatorCommand, ReadingChannels, Sensors

SIGMAS: Final = 6.0
"""Noise passes this many sigmas once in 1e9 readings."""
TURN_RAD: Final = 6.5
"""Largest angle of a resolver: a turn and the error of a resolver."""
CURRENT_SHARE: Final = 1.2
"""Largest current that is read, as a share of the limit: a sensor is wrong by a fifth at most."""
LARGEST_COUNT: Final = 2**52
"""Largest count; beyond it the angle of a count is not exact."""
WINDING_C: Final = (-150.0, 250.0)
"""Temperatures of a winding: below any night on Mars, and above all insulations."""

RESOLVER, CURRENT, GRAVITY = slice(0, 5), slice(5, 10), slice(10, 13)
STRUCTURE, WINDING, ENCODER = 13, slice(14, 19), slice(19, 24)
READ_NOISY: Final = slice(0, 14)
"""Numbers that have noise: they never stay the same for long, even at rest."""
SENSORS: Final = (
    ("resolver_rad", range(5)),
    ("current_A", range(5, 10)),
    ("gravity_R_m_s2", range(10, 13)),
    ("structure_C", range(13, 14)),
    ("winding_C", range(14, 19)),
    ("encoder_count", range(19, 24)),
)
"""Sensors, and the places of their numbers in the order in which these are judged."""
COUNT: Final = 24
"""Numbers of all readings."""
NO_AGE: Final = (0,) * COUNT
NO_TIME: Final = (-inf,) * COUNT
STANDING: Final = (False,) * len(Joint)

Numbers = tuple[float, ...]
Limits = tuple[Numbers, Numbers]
"""Lowest and highest numbers."""


@dataclass(frozen=True, slots=True)
class ReadingBounds:
    """Bounds of the readings; numbers in the order of SENSORS, joints in the order of Joint."""

    persistence: int
    missed_cycles: int
    cycle_s: float
    lowest: Numbers
    highest: Numbers
    gravity_min_m_s2: float
    gravity_max_m_s2: float
    still_step: Numbers
    """Largest changes in a cycle while all brakes are on."""
    turning_step: Numbers
    """Largest changes in a cycle while motors may turn; an encoder may change more towards its set-point."""
    rate_step: Numbers
    """Part of the changes of turning joints that each further cycle allows again."""
    rad_per_count: tuple[float, ...]
    near_resolver_rad: float
    """Distance of the numbers of a sensor from plausible ones at which they surely are plausible too."""
    near_current_A: float
    near_gravity_m_s2: float
    near_structure_K: float
    near_winding_K: float
    near_still_count: float
    near_turning_count: float


def compute_reading_bounds(params: Params, cycle_s: float) -> ReadingBounds:
    """Compute the bounds of the readings."""
    joints, monitors = params.joints.in_order(), params.monitors
    rad_per_count = [2 * np.pi / (j.encoder_counts_per_turn * j.gear_ratio) for j in joints]
    turn_rad = [monitors.setpoint_step_factor * cycle_s * j.speed_rad_s for j in joints]
    turn_count = [turn / rad for turn, rad in zip(turn_rad, rad_per_count, strict=True)]
    at_rest_count = [params.motion.settle_error_rad / rad for rad in rad_per_count]
    noise_rad = SIGMAS * 2**0.5 * monitors.resolver_noise_rad
    crossing_rad = [noise_rad + j.backlash_rad for j in joints]
    most_A = [CURRENT_SHARE * j.current_limit_A + SIGMAS * monitors.current_noise_A for j in joints]
    slow = (*(monitors.gravity_step_m_s2,) * 3, monitors.structure_step_K, *(monitors.winding_step_K,) * 5)
    free_A = (inf,) * len(joints)
    low_C, high_C = WINDING_C
    most_m_s2 = monitors.gravity_max_m_s2
    return ReadingBounds(
        persistence=monitors.reading_persistence,
        missed_cycles=monitors.missed_cycles,
        cycle_s=cycle_s,
        lowest=(
            *(-TURN_RAD,) * 5,
            *(-one for one in most_A),
            *(-most_m_s2,) * 3,
            monitors.structure_min_C,
            *(low_C,) * 5,
            *(-LARGEST_COUNT,) * 5,
        ),
        highest=(
            *(TURN_RAD,) * 5,
            *most_A,
            *(most_m_s2,) * 3,
            monitors.structure_max_C,
            *(high_C,) * 5,
            *(LARGEST_COUNT,) * 5,
        ),
        gravity_min_m_s2=monitors.gravity_min_m_s2,
        gravity_max_m_s2=most_m_s2,
        still_step=(*crossing_rad, *free_A, *slow, *at_rest_count),
        turning_step=(
            *(a + b for a, b in zip(crossing_rad, turn_rad, strict=True)),
            *free_A,
            *slow,
            *turn_count,
        ),
        rate_step=(*turn_rad, *(0.0,) * 14, *turn_count),
        rad_per_count=tuple(rad_per_count),
        near_resolver_rad=min(crossing_rad),
        near_current_A=min(most_A),
        # two numbers near the same ones are at most twice as far from each other
        near_gravity_m_s2=0.5 * monitors.gravity_step_m_s2,
        near_structure_K=0.5 * monitors.structure_step_K,
        near_winding_K=0.5 * monitors.winding_step_K,
        near_still_count=0.5 * min(at_rest_count),
        near_turning_count=min(turn_count),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Near:
    """Plausible numbers, near which others are surely plausible too: one distance a sensor is enough."""

    turning: Flags | None
    """Motors that may turn for which it holds, (5,); None while all brakes are on."""
    gravity: Numbers
    structure_C: float
    winding: Numbers
    encoder: Numbers
    count_step: Numbers
    """Largest changes of the encoders in a cycle where only some motors turn, (5,); else empty."""


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """Part of the history that changes in few cycles; numbers in the order of SENSORS."""

    last: Numbers = ()
    """Last plausible numbers; kept where they are older than those that are used."""
    ages: tuple[int, ...] = NO_AGE
    """Cycles since the last plausible number: 0 for one of this cycle."""
    lasted: tuple[int, ...] = NO_AGE
    """Readings in a row that were not plausible; a cycle that was missed has none."""
    cycle_read: int = 0
    """Cycle count as it was read."""
    cycle_age: int = 0
    """Cycles since a plausible count."""
    is_confirmed: bool = False
    """True once second readings have agreed with the first."""
    begins: bool = False
    """True if the history begins with the readings of this cycle: the estimate must begin with them."""
    turned: tuple[bool, ...] = STANDING
    """Joints that may have turned since their last plausible numbers."""
    unused: tuple[int, ...] = NO_AGE
    """How often each number was not used since boot."""
    unused_at: tuple[float, ...] = NO_TIME
    """Cycle count at which a number was last not used."""


NO_HISTORY: Final = History()


@cycle_record
class ReadingState:
    """Readings of the last cycles; numbers in the order of SENSORS."""

    cycle: int = 0
    """Cycle count of the avionics that is believed."""
    read: Numbers = ()
    """Numbers as they were read."""
    used: Numbers = ()
    """Numbers that are used; empty while none can be."""
    earlier: Numbers = ()
    """Plausible numbers before the last plausible ones."""
    history: History = NO_HISTORY
    near: Near | None = None
    """Numbers near which others are plausible; None where each must be judged."""

    @property
    def usable(self) -> bool:
        """Return whether there are numbers to be used."""
        return bool(self.used)

    @property
    def begins(self) -> bool:
        """Return whether the estimate must begin with these readings."""
        return self.history.begins

    @property
    def is_plain(self) -> bool:
        """Return whether all numbers are plausible."""
        return self.history.ages == NO_AGE

    @property
    def last(self) -> Numbers:
        """Last plausible numbers."""
        return self.used if self.is_plain else self.history.last


def judge(
    bounds: ReadingBounds, last: ReadingState, sensors: Sensors, turning: Flags | None, drive: ActuatorCommand
) -> tuple[ReadingState, Sensors, tuple[Evr, ...]]:
    """Judge the readings of a cycle.

    Args:
        turning: Motors that may have turned since the last readings, (5,); None while all brakes are on.
        drive: Actuator command since the last readings.

    Returns:
        The history, the readings to be used, and the events, among them the faults.
    """
    resolver, current = sensors.resolver_rad.tolist(), sensors.current_A.tolist()
    gravity, winding = sensors.gravity_R_m_s2.tolist(), sensors.winding_C.tolist()
    encoder, structure_C = sensors.encoder_count.tolist(), sensors.structure_C
    read = (*resolver, *current, *gravity, structure_C, *winding, *encoder)
    near = last.near
    if (
        near is not None
        and near.turning is turning
        and sensors.cycle == last.cycle + 1
        and dist(resolver, last.used[RESOLVER]) <= bounds.near_resolver_rad
        and hypot(*current) <= bounds.near_current_A
        and dist(gravity, near.gravity) <= bounds.near_gravity_m_s2
        and abs(structure_C - near.structure_C) <= bounds.near_structure_K
        and dist(winding, near.winding) <= bounds.near_winding_K
        and (
            dist(encoder, near.encoder) <= bounds.near_still_count
            if turning is None
            else _turn_near(bounds, near, last.used, encoder, drive)
        )
    ):
        return ReadingState(sensors.cycle, read, read, last.used, last.history, near), sensors, ()
    return _judge_each(bounds, last, sensors, read, turning, drive)


def _turn_near(
    bounds: ReadingBounds, near: Near, last: Numbers, encoder: list[int], drive: ActuatorCommand
) -> bool:
    """Return whether the encoders of motors that turn are surely plausible: near their set-points."""
    if near.count_step:
        return all(map(le, map(abs, map(sub, encoder, last[ENCODER])), near.count_step))
    return dist(encoder, drive.setpoint_count.tolist()) <= bounds.near_turning_count


def _find_near(bounds: ReadingBounds, read: Numbers, turning: Flags | None) -> Near | None:
    """Return plausible numbers, near which others surely are; None if they are near the end of a range."""
    gravity, structure_C, winding = read[GRAVITY], float(read[STRUCTURE]), read[WINDING]
    pull_m_s2, by_m_s2 = hypot(*gravity), bounds.near_gravity_m_s2
    low, high = bounds.lowest, bounds.highest
    if (
        bounds.gravity_min_m_s2 > pull_m_s2 - by_m_s2
        or bounds.gravity_max_m_s2 < pull_m_s2 + by_m_s2
        or low[STRUCTURE] > structure_C - bounds.near_structure_K
        or high[STRUCTURE] < structure_C + bounds.near_structure_K
        or WINDING_C[0] > min(winding) - bounds.near_winding_K
        or WINDING_C[1] < max(winding) + bounds.near_winding_K
    ):
        return None
    count_step: Numbers = ()
    if turning is not None and not all(turns := turning.tolist()):
        some, still = bounds.turning_step[ENCODER], bounds.still_step[ENCODER]
        count_step = tuple(a if turn else b for turn, a, b in zip(turns, some, still, strict=True))
    return Near(turning, gravity, structure_C, winding, read[ENCODER], count_step)


def _judge_each(
    bounds: ReadingBounds,
    last: ReadingState,
    sensors: Sensors,
    read: Numbers,
    turning: Flags | None,
    drive: ActuatorCommand,
) -> tuple[ReadingState, Sensors, tuple[Evr, ...]]:
    """Judge the readings number by number."""
    before = last.history
    cycle, history, elapsed, evrs = _judge_cycle(bounds, last, sensors.cycle)
    in_range = _find_in_range(bounds, read)
    if not last.usable:
        begun = ReadingState(cycle, read, history=history)
        return _begin(bounds, begun, sensors, in_range, (bounds.lowest, bounds.highest), evrs)
    turns = STANDING if turning is None else tuple(turning.tolist())
    turned = tuple(
        now or (was and max(before.ages[k], before.ages[ENCODER.start + k]) > 0)
        for k, (now, was) in enumerate(zip(turns, before.turned, strict=True))
    )
    target, since = drive.setpoint_count.tolist(), last.last
    limits = _compute_limits(bounds, before.ages, since, turned, target, elapsed)
    wider = _compute_limits(bounds, before.ages, last.earlier, turned, target, elapsed + 1)
    plausible = [
        ok and (low <= now <= high or lower <= now <= higher)
        for ok, now, low, high, lower, higher in zip(in_range, read, *limits, *wider, strict=True)
    ]
    plausible[GRAVITY] = [all(plausible[GRAVITY])] * 3
    if not before.is_confirmed and not all(a or not b for a, b in zip(plausible, in_range, strict=True)):
        begun = ReadingState(cycle, read, history=history)
        if all(in_range) and not any(turns):
            # the first readings are not used any more: tell what they were, beside the present ones
            around = _compute_limits(bounds, NO_AGE, read, turned, target, elapsed)
            told, found = _tell(bounds, replace(begun, read=since), plausible, around)
            begun = replace(begun, history=told.history)
            return _begin(bounds, begun, sensors, in_range, limits, evrs + found)
        return _begin(bounds, begun, sensors, in_range, limits, evrs, plausible, any(turns))
    if all(plausible):
        history = replace(
            history, ages=NO_AGE, lasted=NO_AGE, is_confirmed=True, begins=False, turned=STANDING
        )
        near = None if history.cycle_age else _find_near(bounds, read, turning)
        return ReadingState(cycle, read, read, since, history, near), sensors, evrs
    ages = tuple(0 if good else age + elapsed for good, age in zip(plausible, before.ages, strict=True))
    lasted = _count_lasted(before, plausible)
    kept = tuple(now if good else was for good, now, was in zip(plausible, read, since, strict=True))
    history = replace(history, last=kept, ages=ages, lasted=lasted, begins=False, turned=turned)
    used = _choose(bounds, last, read, plausible, drive, elapsed)
    earlier = tuple(a if good else b for good, a, b in zip(plausible, since, last.earlier, strict=True))
    told, found = _tell(bounds, ReadingState(cycle, read, used, earlier, history), plausible, limits)
    return told, _with_numbers(sensors, used), evrs + found


def _count_lasted(history: History, plausible: list[bool]) -> tuple[int, ...]:
    """Count the readings in a row that were not plausible."""
    return tuple(0 if good else n + 1 for good, n in zip(plausible, history.lasted, strict=True))


def _judge_cycle(
    bounds: ReadingBounds, last: ReadingState, cycle: int
) -> tuple[int, History, int, tuple[Evr, ...]]:
    """Judge the cycle count; return the one that is believed, the history, the cycles passed, and events.

    Another count than the next few is believed, and reported, once the count after it agrees. A count that
    agrees with none for as long as its persistence is a fault.
    """
    passed, before = cycle - last.cycle, last.history
    believed = replace(before, cycle_read=cycle, cycle_age=0)
    if not last.read:
        return cycle, believed, 1, ()
    if 1 <= passed <= 1 + bounds.missed_cycles:
        return cycle, believed, passed, () if passed == 1 else (CyclesSkipped(passed - 1),)
    agrees = before.cycle_age > 0 and cycle == before.cycle_read + 1
    if agrees and passed > 0:
        return cycle, believed, 1, (CyclesMissed(passed - 1, bounds.missed_cycles),)
    if agrees or before.cycle_age + 1 >= bounds.persistence:
        return cycle, believed, 1, (CycleCountWrong(cycle, last.cycle),)
    expected = last.cycle + 1
    told = ReadingNotUsed("cycle", float(cycle), float(expected), float(expected + bounds.missed_cycles))
    doubted = replace(before, cycle_read=cycle, cycle_age=before.cycle_age + 1)
    return expected, doubted, 1, (told,) if before.cycle_age == 0 else ()


def _find_in_range(bounds: ReadingBounds, read: Numbers) -> list[bool]:
    """Find the numbers within their ranges; gravity is one, and has a magnitude."""
    in_range = [
        low <= now <= high for now, low, high in zip(read, bounds.lowest, bounds.highest, strict=True)
    ]
    pull_m_s2 = hypot(*read[GRAVITY])
    in_range[GRAVITY] = [bounds.gravity_min_m_s2 <= pull_m_s2 <= bounds.gravity_max_m_s2] * 3
    return in_range


def _compute_limits(
    bounds: ReadingBounds,
    ages: tuple[int, ...],
    since: Numbers,
    turned: tuple[bool, ...],
    target: list[int],
    elapsed: int,
) -> Limits:
    """Compute the lowest and highest numbers that can follow others, `elapsed` cycles after their last age.

    A motor may turn to its set-point, and beyond it by as much as it was away from it.
    """
    lowest: list[float] = []
    highest: list[float] = []
    for k, (value, age, rate) in enumerate(zip(since, ages, bounds.rate_step, strict=True)):
        turns = rate > 0.0 and turned[k % 5 if k < 5 else k - ENCODER.start]
        step = bounds.still_step[k]
        low = high = value
        if turns:
            step = bounds.turning_step[k] + rate * (age + elapsed - 1)
            if k >= ENCODER.start:
                goal = target[k - ENCODER.start]
                low, high = min(value, goal), max(value, goal)
                step += high - low
        lowest.append(low - step)
        highest.append(high + step)
    return tuple(lowest), tuple(highest)


def _begin(
    bounds: ReadingBounds,
    begun: ReadingState,
    sensors: Sensors,
    in_range: list[bool],
    limits: Limits,
    evrs: tuple[Evr, ...],
    agreed: list[bool] | None = None,
    turns: bool = False,
) -> tuple[ReadingState, Sensors, tuple[Evr, ...]]:
    """Begin with the readings of this cycle, if all are in range; else none can be used.

    Args:
        agreed: Numbers that agreed with the first ones; None if there were none.
        turns: True if a move is under way: it was planned from what is contradicted, which is a fault.
    """
    good = in_range if agreed is None or not all(in_range) else agreed
    ages, read = begun.history.ages, begun.read
    if all(in_range):
        history = replace(begun.history, ages=NO_AGE, lasted=NO_AGE, is_confirmed=False, begins=True)
        begun = replace(begun, used=read, earlier=read, history=history)
    else:
        ages = tuple(0 if ok else age + 1 for ok, age in zip(good, ages, strict=True))
        lasted = _count_lasted(begun.history, good)
        begun = replace(begun, history=replace(begun.history, ages=ages, lasted=lasted, begins=False))
    after, found = _tell(bounds, begun, good, limits, is_fault=turns)
    return after, sensors, evrs + found


def _tell(
    bounds: ReadingBounds, state: ReadingState, plausible: list[bool], limits: Limits, is_fault: bool = False
) -> tuple[ReadingState, tuple[Evr, ...]]:
    """Count the numbers that are not plausible; tell each once, and those that have lasted as faults.

    A number is told again only after it was plausible for as long as its persistence.
    """
    evrs: list[Evr] = []
    history = state.history
    for sensor, numbers in SENSORS:
        bad = [k for k in numbers if not plausible[k]]
        lasting = [k for k in bad if is_fault or history.lasted[k] >= bounds.persistence]
        new = [k for k in bad if state.cycle - history.unused_at[k] > bounds.persistence]
        if lasting:
            evrs.append(ReadingImplausible(*_describe(bounds, sensor, lasting, state.read, limits)))
        elif new:
            evrs.append(ReadingNotUsed(*_describe(bounds, sensor, new, state.read, limits)))
    unused = tuple(n + (not good) for n, good in zip(history.unused, plausible, strict=True))
    at = tuple(
        was if good else float(state.cycle) for was, good in zip(history.unused_at, plausible, strict=True)
    )
    return replace(state, history=replace(history, unused=unused, unused_at=at)), tuple(evrs)


def _describe(
    bounds: ReadingBounds, sensor: str, numbers: list[int], read: Numbers, limits: Limits
) -> tuple[str, float, float, float]:
    """Describe numbers of a sensor: their channel, and value and limits of the first or of the magnitude."""
    first = numbers[0]
    if sensor == "gravity_R_m_s2":
        pull_m_s2 = hypot(*read[GRAVITY])
        if not bounds.gravity_min_m_s2 <= pull_m_s2 <= bounds.gravity_max_m_s2:
            return sensor, pull_m_s2, bounds.gravity_min_m_s2, bounds.gravity_max_m_s2
    start = next(places.start for name, places in SENSORS if name == sensor)
    where = "" if sensor == "structure_C" else f"[{','.join(str(k - start) for k in numbers)}]"
    low, high = max(limits[0][first], bounds.lowest[first]), min(limits[1][first], bounds.highest[first])
    return f"{sensor}{where}", float(read[first]), float(low), float(high)


def _choose(
    bounds: ReadingBounds,
    last: ReadingState,
    read: Numbers,
    plausible: list[bool],
    drive: ActuatorCommand,
    elapsed: int,
) -> Numbers:
    """Choose the numbers to be used: as read, or in place of one that is not plausible the last one.

    A motor goes on as it turned between its last two plausible readings, at its commanded rate at most. A
    resolver goes on as its motor does.
    """
    used = [now if good else was for good, now, was in zip(plausible, read, last.used, strict=True)]
    for joint, rate_rad_s in enumerate(drive.setpoint_rate_rad_s.tolist()):
        k = ENCODER.start + joint
        if not plausible[k]:
            most = round(rate_rad_s * elapsed * bounds.cycle_s / bounds.rad_per_count[joint])
            turned = int(last.last[k] - last.earlier[k])
            used[k] += max(0, min(most, turned)) if most > 0 else min(0, max(most, turned))
        if not plausible[joint]:
            used[joint] += float(used[k] - last.used[k]) * bounds.rad_per_count[joint]
    return tuple(used)


def _with_numbers(sensors: Sensors, used: Numbers) -> Sensors:
    """Return the readings with other numbers."""
    return replace(
        sensors,
        resolver_rad=np.array(used[RESOLVER]),
        current_A=np.array(used[CURRENT]),
        gravity_R_m_s2=np.array(used[GRAVITY]),
        structure_C=used[STRUCTURE],
        winding_C=np.array(used[WINDING]),
        encoder_count=np.array(used[ENCODER], np.int64),
    )


def accept_present(
    bounds: ReadingBounds, state: ReadingState
) -> tuple[ReadingState, tuple[tuple[Joint, int], ...]] | str:
    """Take the numbers that are not plausible as they are read, as the ground has ordered.

    Returns:
        The history, and by how many counts each encoder reads more than what was used in its place; or why a
        number cannot be used.
    """
    in_range = _find_in_range(bounds, state.read)
    dead = [sensor for sensor, numbers in SENSORS if not all(in_range[k] for k in numbers)]
    if dead:
        return f"out of range: {', '.join(dead)}"
    if state.is_plain:
        return state, ()
    read, ages = state.read, state.history.ages
    jumps = tuple(
        (joint, int(read[k] - state.used[k])) for joint in Joint if ages[k := ENCODER.start + joint] > 0
    )
    history = replace(state.history, ages=NO_AGE, lasted=NO_AGE, turned=STANDING)
    return replace(state, used=read, earlier=read, history=history), jumps


def reading_channels(tick: int, state: ReadingState) -> ReadingChannels:
    """Return the channels of the readings."""
    valid, unused = np.array(state.history.ages) == 0, np.array(state.history.unused)
    return ReadingChannels(
        tick=tick,
        encoder_valid=valid[ENCODER],
        resolver_valid=valid[RESOLVER],
        current_valid=valid[CURRENT],
        winding_valid=valid[WINDING],
        gravity_valid=bool(valid[GRAVITY].all()),
        structure_valid=bool(valid[STRUCTURE]),
        encoder_unused_count=unused[ENCODER],
        resolver_unused_count=unused[RESOLVER],
        current_unused_count=unused[CURRENT],
        winding_unused_count=unused[WINDING],
        gravity_unused_count=int(unused[GRAVITY].max()),
        structure_unused_count=int(unused[STRUCTURE]),
    )
