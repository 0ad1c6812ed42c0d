"""Random cycles, made from the annotations of the messages."""

import struct
from collections.abc import Callable, Iterable
from dataclasses import fields, is_dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from fsw.dictionary.commands import GuardedMove, Stop
from fsw.dictionary.evrs import Booted, ContactMade
from marsarm.telemetry.recorder import Recorder
from marsarm.telemetry.schema import arm_names, array_shape, is_tool_index, strip_optional
from sim.arms import nominal_params
from sim.record import CycleRecord

ARM = arm_names(nominal_params())
EVENTS = {
    "commands": (Stop(), GuardedMove("apxs", (1.0, 0.25, -0.5), (0.0, 0.0, float("nan")))),
    "evrs": (Booted("é" * 3), ContactMade("apxs_1", 0.1)),
}

Bytes = Callable[[int], bytes]


def value_of(owner: type, name: str, hint: Any, some: Bytes) -> Any:
    """Return a value of an annotated type, with bits from `some`."""
    kind = strip_optional(hint)
    if get_origin(kind) is np.ndarray:
        scalar = np.dtype(get_args(get_args(kind)[1])[0])
        shape = array_shape(owner, name, ARM)
        raw = np.frombuffer(some(scalar.itemsize * int(np.prod(shape))), np.uint8)
        return (raw & 1 if scalar.kind == "b" else raw).view(scalar).reshape(shape)
    if is_dataclass(kind):
        return packet_of(kind, some)
    if name in EVENTS:
        return EVENTS[name]
    if is_tool_index(hint):
        return some(1)[0] % len(ARM.tools)
    if issubclass(kind, IntEnum):
        return list(kind)[some(1)[0] % len(kind)]
    return struct.unpack({bool: "<?", int: "<q", float: "<d"}[kind], some(1 if kind is bool else 8))[0]


def packet_of(kind: type, some: Bytes, **given: Any) -> Any:
    """Return a packet, or a whole cycle, of random content except the given fields."""
    hints = get_type_hints(kind, include_extras=True)
    made = (f.name for f in fields(kind) if f.name not in given)
    return kind(**given, **{name: value_of(kind, name, hints[name], some) for name in made})


def cycle_at(tick: int) -> CycleRecord:
    """Return a random cycle, the same for the same tick on any machine."""
    return packet_of(CycleRecord, np.random.default_rng(tick).bytes, tick=tick)


def record(path: Path, cycles: Iterable[CycleRecord], **more: Any) -> Path:
    """Record cycles to a closed log."""
    with Recorder(path, {"seed": "1", "arm": "nominal"}, **more) as recorder:
        for cycle in cycles:
            recorder.write(cycle)
    return path
