"""Random commands for the campaign of commands: well-typed, ill-typed, and what is no command at all.

Values are drawn from the annotations of a command, so that a new command or field needs nothing here.
"""

from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from decimal import Decimal
from enum import IntEnum
from types import NoneType, UnionType
from typing import Any, Final, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

from fsw.dictionary.commands import ClearFault, Command, MoveJoints, SetParam, Stop, Stow
from fsw.dictionary.params import Params
from fsw.dictionary.types import DirectionMark, Limits, NameMark
from fsw.executive.context import known_names
from fsw.state import Hold

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
    None,
    3,
    "Stop",
    Stop,
    {},
    (Stop(),),
    Hold(1.0, vibrate=True),
    np.zeros(5),
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
    return kind(
        **{field.name: _draw_value(random, params, field.name, hints[field.name]) for field in fields(kind)}
    )


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
    number = _choose(
        random,
        (
            float(random.uniform(low, high)),
            float(low + (high - low) * 0.1 * random.random()),
            limits.low,
            limits.high,
            float(np.nextafter(limits.high, np.inf)),
        ),
    )
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
