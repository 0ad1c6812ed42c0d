"""Campaign of commands: random ones of right and wrong types in the closed loop, from huge to tiny numbers.

Some readings are wrong, by any size. Flight software must not end with an exception or a warning. While a
fault stands the brakes are on, and at the end of a run a stop brings the arm to rest on its brakes. A cycle
whose commands are all refused must drive the actuators, to the last bit, as one without commands. Values are
drawn from the annotations of a command, so that a new command or field needs nothing here.
"""

import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from decimal import Decimal
from enum import IntEnum
from functools import cache
from types import NoneType, UnionType
from typing import Any, Final, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from fsw.config import Config
from fsw.cycle import step
from fsw.dictionary.commands import ClearFault, Command, MoveJoints, Preload, SetParam, Stop, Stow
from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import CommandAccepted, CommandRefused
from fsw.dictionary.params import Params, TeachPoint
from fsw.dictionary.types import DirectionMark, Limits, NameMark, joints5
from fsw.executive.context import known_names
from fsw.messages import ActuatorCommand, Sensors
from fsw.state import Hold, State
from sim.arms import BuiltArm, arm_named
from sim.initialisation import start_loop, true_reference
from sim.loop import ClosedLoop, Setup
from sim.placement import place_command, random_placement
from sim.record import CycleRecord
from sim.sequence import run_sequence
from simgap.common.errors import BadRequest
from validation.campaigns import Context, Document
from validation.wild_readings import Draw, draw_reading

WRONG_SHARE: Final = 0.02
"""Share of cycles with a wrong reading."""
END_CYCLES: Final = 2000
"""Cycles in which a stop must bring any arm to rest."""
MOST_FORCE: Final = 1.5
"""Largest contact force at the end, as a share of the largest that may be commanded."""
RUN_CYCLES: Final = 500
"""Cycles from a start of the arm; after more, most arms have a standing fault or unfit parameters."""
COMMAND_SHARE: Final = {True: 0.1, False: 0.6}
"""Share of cycles with commands while a command is under way, and while none is."""
MOST_COMMANDS: Final = 3
LONGEST_REASON: Final = 400
"""Longest reason of a refusal; lists of names have up to 300 characters."""
DRIVE_FIELDS: Final = tuple(field.name for field in fields(ActuatorCommand))
HERE: Final = TeachPoint("here", "apxs", (1.4, 0.0, -0.3), (0.0, 0.0, 1.0))


@dataclass(frozen=True, slots=True)
class RunResult:
    """Commands of a run by what became of them, and the bugs that were found."""

    cycles: int
    commands: int
    accepted: dict[str, int]
    refused: dict[str, int]
    bugs: tuple[str, ...]


def fuzz_run(seed: int, number: int, cycles: int) -> RunResult:
    """Run an arm under random commands."""
    random = np.random.default_rng([seed, number])
    loop = start(number)
    commands_sent, accepted, refused = 0, Counter[str](), Counter[str]()
    bugs: list[str] = []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for done in range(cycles):
            share = COMMAND_SHARE[loop.state.is_busy]
            sent = random.integers(1, MOST_COMMANDS + 1) if random.random() < share else 0
            commands = tuple(draw_command(random, loop.config.params) for _ in range(sent))
            before, commands_sent = loop.state, commands_sent + len(commands)
            record = cycle_with(loop, commands, draw_wrong(random))
            accepted.update(evr.command for evr in record.outputs.evrs if isinstance(evr, CommandAccepted))
            refused.update(evr.command for evr in record.outputs.evrs if isinstance(evr, CommandRefused))
            bugs += [f"run {number}, cycle {done}: {bug}" for bug in find_bugs(loop, before, record)]
            if loop.failure is not None:
                return RunResult(done + 1, commands_sent, dict(accepted), dict(refused), tuple(bugs))
        bugs += [f"run {number}: {bug}" for bug in find_unsafe_end(loop)]
    return RunResult(cycles, commands_sent, dict(accepted), dict(refused), tuple(bugs))


def draw_wrong(random: np.random.Generator) -> Draw | None:
    """Draw a wrong reading, in few cycles."""
    return draw_reading(random, "once") if random.random() < WRONG_SHARE else None


def cycle_with(loop: ClosedLoop, commands: tuple[Command, ...], wrong: Draw | None) -> CycleRecord:
    """Run a cycle with a wrong reading, or without one."""
    if wrong is None:
        return loop.cycle(commands)
    avionics, sense = vars(loop.avionics), loop.avionics.sense
    avionics["sense"] = lambda: wrong.corrupt(sense())
    try:
        return loop.cycle(commands)
    finally:
        del avionics["sense"]


def find_unsafe_end(loop: ClosedLoop) -> list[str]:
    """Describe an arm that a stop does not bring to rest on its brakes, or that presses too hard."""
    record = loop.cycle((Stop(),))
    for _ in range(END_CYCLES):
        if not record.outputs.joint.busy:
            break
        record = loop.cycle()
    force_N, most_N = loop.truth().contact_force_N, MOST_FORCE * loop.config.params.preload.max_force_N
    bugs = [] if loop.braked else ["the arm is not on its brakes at the end"]
    return bugs if force_N <= most_N else [*bugs, f"it presses with {force_N:.0f} N at the end"]


@cache
def pressed() -> ClosedLoop:
    """Run an arm to a press of 300 N."""
    arm = with_point(arm_named("nominal"))
    world, preview = random_placement(0, arm, "drill", 0.0)
    place = place_command(preview.placement)
    loop = ClosedLoop(Setup(arm, world, joints5(preview.standoff_rad), 0, true_reference(arm)))
    for _ in run_sequence(loop, (place, Preload("drill", 300.0))):
        pass
    return loop


def with_point(arm: BuiltArm) -> BuiltArm:
    """Return the arm with a taught point."""
    return replace(arm, params=replace(arm.params, teach=(HERE,)))


def start(number: int) -> ClosedLoop:
    """Start an arm with a taught point: in turn stowed, ready, where joints find hardstops, and pressing."""
    if number % 4 == 3:
        return pressed().fork()
    arm = with_point(arm_named("nominal"))
    poses = (arm.params.poses.stowed_rad, arm.params.poses.ready_rad, arm.params.hardstop.start_rad)
    return start_loop(arm, start_rad=poses[number % len(poses)], seed=number, with_truth=False)


def find_bugs(loop: ClosedLoop, before: State, record: CycleRecord) -> list[str]:
    """Describe what a cycle shows that must not be."""
    if loop.failure is not None:
        return [f"{type(loop.failure).__name__}: {loop.failure}; commands {record.commands!r:.2000}"]
    drive, mode = record.outputs.drive, record.outputs.joint.mode
    unsafe = mode is Mode.FAULTED and (drive.brake_release.any() or drive.setpoint_rate_rad_s.any())
    if unsafe:
        return ["a fault stands, and the brakes are not on"]
    reasons = [evr.reason for evr in record.outputs.evrs if isinstance(evr, CommandRefused)]
    bugs = [f"a reason of {len(reason)} characters" for reason in reasons if len(reason) > LONGEST_REASON]
    if record.commands and len(reasons) >= len(record.commands):
        bugs += _find_change(loop.config, before, record.sensors, record)
    return bugs


def _find_change(config: Config, before: State, sensors: Sensors, record: CycleRecord) -> list[str]:
    """Compare a cycle of refused commands with the same cycle without commands."""
    state, quiet = step(config, before, sensors, ())
    others = [evr for evr in quiet.evrs if isinstance(evr, CommandRefused)]
    refused = sum(isinstance(evr, CommandRefused) for evr in record.outputs.evrs) - len(others)
    if refused != len(record.commands):
        return []
    # by their texts: a reading that is no number differs from itself
    left = [evr.message for evr in record.outputs.evrs if not isinstance(evr, CommandRefused)]
    same_events = left == [evr.message for evr in quiet.evrs if not isinstance(evr, CommandRefused)]
    drive, still = record.outputs.drive, quiet.drive
    same_drive = all(np.array_equal(getattr(drive, name), getattr(still, name)) for name in DRIVE_FIELDS)
    if same_events and same_drive and state.mode is Mode(record.outputs.joint.mode):
        return []
    return [f"refused commands changed the cycle: {record.commands!r:.2000}"]


def campaign(context: Context, cycles: int = 250_000) -> Document:
    """Run all cycles; the same arguments give the same result."""
    if cycles < 1:
        raise BadRequest("set: cycles are 1 or more")
    runs = -(-cycles // RUN_CYCLES)
    jobs = [(context.seed, k, min(RUN_CYCLES, cycles - k * RUN_CYCLES)) for k in range(runs)]
    results = context.each(fuzz_run, jobs, "runs")
    accepted = sum((Counter(one.accepted) for one in results), Counter[str]())
    refused = sum((Counter(one.refused) for one in results), Counter[str]())
    bugs = [bug for one in results for bug in one.bugs]
    return {
        "cycles": sum(one.cycles for one in results),
        "seed": context.seed,
        "in_bounds": not bugs,
        "commands": sum(one.commands for one in results),
        "accepted": dict(accepted.most_common()),
        "refused": dict(refused.most_common()),
        "bugs": bugs,
    }


Random = np.random.Generator
COMMAND_TYPES: Final = get_args(Command)
BAD_SHARE: Final = 0.15
"""Share of values that are drawn from all types; most commands of several fields then have one or none."""
NOTHING_SHARE: Final = 0.03
"""Share of objects that are no command."""
END_SHARE: Final = 0.1
"""Share of commands that end a move or clear a fault, so that many commands find the arm at rest."""
RARE: Final = (SetParam, Stow)
"""Commands that leave an arm that always faults, or one that only unstows."""
RARE_SHARE: Final = 0.1
"""Share of the rare commands that are sent."""
WORKSPACE_M: Final = (2.0, 0.0, 0.8)
"""Centre of the positions of most targets, in the rover frame."""
FORWARD_DOWN: Final = (1.0, 0.0, 1.5)
"""Middle of the directions, which is forward and down in the rover frame."""
BAD_NUMBERS: Final = (
    float("nan"), float("inf"), -float("inf"), 1e308, -1e308, 3e306, 1e306, 1e150, 1e20, 1e9, -1e9, 7.01,
    -0.0, 5e-324, -5e-324, 2.3e-308, 1e-200, 10**400, -(10**400), 10**18, 0, 1, -1, True, False,
    np.float32(3e38), np.float16(6e4), np.int64(-(2**63)), np.uint64(2**64 - 1), np.longdouble("1e4000"),
    np.bool_(True), np.float64(0.1),
)  # fmt: skip
BAD_TEXTS: Final = ("", "drill", "DRILL", "Elbow", "\ud800", "a\nb", "\0", "x" * 101, "é" * 50, "{e}", "%s")
BAD_OTHERS: Final[tuple[Any, ...]] = (
    None, b"drill", 1j, Decimal("1e999"), object(), dict, len, {"a": 1}, {1.0}, range(3), (), [],
    ((1.0,),) * 3, (1.0, 2.0), [1.0, 2.0, 3.0], (1.0,) * 6, (1e306,) * 5, ("1", "2", "3"),
    [None] * 5, (True, False, True),
    np.zeros(3), np.full(5, np.nan), np.zeros((3, 1)), np.array(1.0), np.array(["a", "b", "c"]),
    np.array([1, 2, None]), np.zeros(10_000), (0.0, 0.0, 0.0), (1e-300, 0.0, 0.0), (1e200, 1e200, -1e200),
)  # fmt: skip
BAD_VALUES: Final = (*BAD_NUMBERS, *BAD_TEXTS, *BAD_OTHERS)
NO_COMMANDS: Final[tuple[Any, ...]] = (
    *(None, 3, "Stop", Stop, {}, (Stop(),)),
    *(Hold(1.0, vibrate=True), np.zeros(5)),
)


def draw_command(random: Random, params: Params) -> Any:
    """Draw a command, or now and then an object that is none."""
    share = random.random()
    if share < NOTHING_SHARE:
        return _choose(random, NO_COMMANDS)
    if share < NOTHING_SHARE + END_SHARE:
        return _choose(random, (Stop(), ClearFault()))
    kind = _choose(random, COMMAND_TYPES)
    if kind in RARE and random.random() > RARE_SHARE:
        kind = MoveJoints
    hints = get_type_hints(kind, include_extras=True)
    names = [one.name for one in fields(kind)]
    values = {name: _draw_value(random, params, name, hints[name]) for name in names}
    return kind(**values)


def _draw_value(random: Random, params: Params, name: str, hint: Any) -> Any:
    if random.random() < BAD_SHARE:
        return _choose(random, BAD_VALUES)
    if get_origin(hint) in (Union, UnionType):
        option = _choose(random, get_args(hint))
        return None if option is NoneType else _draw_value(random, params, name, option)
    marks = getattr(hint, "__metadata__", ())
    bare = hint.__origin__ if marks else hint
    for mark in marks:
        if isinstance(mark, NameMark):
            known = _choose(random, known_names(params)[mark])
            return known.lower() if random.random() < 0.5 else known
    if get_origin(bare) is Literal:
        return _choose(random, get_args(bare))
    if get_origin(bare) is tuple:
        return _draw_vector(random, len(get_args(bare)), marks)
    if bare is bool:
        return bool(random.integers(2))
    if bare is str:
        return _choose(random, tuple(_names(params, "")))
    if isinstance(bare, type) and issubclass(bare, IntEnum):
        return _choose(random, tuple(bare))
    return _draw_number(random, marks)


def _draw_number(random: Random, marks: tuple[Any, ...]) -> Any:
    """Draw a number within the limits, at one of them or next to one, of any type."""
    limits = next(mark for mark in marks if isinstance(mark, Limits))
    low, high = max(limits.low, -3.0), min(limits.high, 100.0)
    inside = float(random.uniform(low, high)), float(low + (high - low) * 0.1 * random.random())
    ends = limits.low, limits.high, float(np.nextafter(limits.high, np.inf))
    number = _choose(random, (*inside, *ends))
    kind: Callable[[float], Any] = _choose(random, (float, float, float, np.float64, np.float32))
    return kind(number)


def _draw_vector(random: Random, count: int, marks: tuple[Any, ...]) -> Any:
    """Draw a direction, a position in the workspace, or joint angles; as any sequence."""
    if any(isinstance(mark, DirectionMark) for mark in marks):
        numbers = (random.normal(size=count) + FORWARD_DOWN) * 10.0 ** random.integers(-9, 9)
    elif count == 3:
        numbers = np.array(WORKSPACE_M) + random.normal(size=3) * random.choice([0.3, 10.0])
    else:
        numbers = random.normal(size=count) * random.choice([0.05, 1.0, 4.0])
    kind: Callable[[Any], Any] = _choose(random, (tuple, tuple, list, np.array))
    return kind(numbers)


def _names(params: Any, place: str) -> Iterator[str]:
    """Yield the names of all parameters and of the points that are taught."""
    for field in fields(params):
        value = getattr(params, field.name)
        yield f"{place}{field.name}"
        if is_dataclass(value):
            yield from _names(value, f"{place}{field.name}.")
    if not place:
        yield from (point.name for point in params.teach)


def _choose(random: Random, values: tuple[Any, ...]) -> Any:
    return values[int(random.integers(len(values)))]
