"""What a log holds of what went into flight software: what it began with, its sensors and its commands."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fsw.config import digest
from fsw.dictionary.commands import Command
from fsw.dictionary.enums import Mode
from fsw.dictionary.params import Params
from fsw.dictionary.validity import check_arm, check_limits
from fsw.estimate.reference import Reference
from fsw.messages import Sensors
from ground.telemetry.format import COMMAND_TOPIC, TICK_NS
from ground.telemetry.json_codec import BadJson, command_from_json, record_from_json
from ground.telemetry.lost_messages import LostMessages, trailing_bytes_text
from ground.telemetry.read import Log
from ground.telemetry.schema import PER_JOINT, packet_layout
from sim.params import nominal_params

SENSOR_TOPIC: Final = "/sensors"
REQUIRED_TOPICS: Final = (None, SENSOR_TOPIC, COMMAND_TOPIC)
"""Topics without which a replay ends; what is lost of the others is a difference of length."""
REQUIRED_KEYS: Final = ("params", "params_sha256", "boot")


class NotReplayable(ValueError):
    """A log that cannot be replayed; the message says why."""


@dataclass(frozen=True, slots=True, eq=False)
class Inputs:
    """All that flight software was given, from its first cycle on."""

    params: Params
    mode: Mode
    reference: Reference | None
    sensors: Mapping[str, NDArray[Any]]
    """By field of Sensors, a row a tick."""
    commands: Mapping[int, tuple[Command, ...]]
    """By tick."""
    ticks: int
    notes: tuple[str, ...]
    """Sentences about what is not as it was."""

    def sensors_at(self, tick: int) -> Sensors:
        """The readings of one cycle, arrays of its own."""
        row: dict[str, Any] = {name: values[tick] for name, values in self.sensors.items()}
        row = {n: v.copy() if isinstance(v, np.ndarray) else v.item() for n, v in row.items()}
        return Sensors(**row)


def inputs_from_log(log: Log) -> Inputs:
    """What a log holds of what went into flight software.

    A log cut short, or with a gap, is good up to the last tick that is surely whole.

    Raises:
        NotReplayable: it lacks something, or something in it is unknown to today's flight software.
    """
    notes: list[str] = [] if not log.behind else [trailing_bytes_text(log.behind)]
    try:
        params, mode, reference = _start_conditions(log, notes)
        commands: dict[int, tuple[Command, ...]] = {}
        for entry in log.commands:
            command = command_from_json(entry.name, entry.fields, notes)
            commands[entry.tick] = (*commands.get(entry.tick, ()), command)
    except (BadJson, ValueError, RecursionError) as error:
        raise NotReplayable(f"log {log.path}: {error}") from error
    ticks = _count_whole_ticks(log, notes)
    return Inputs(params, mode, reference, _sensor_columns(log), commands, ticks, tuple(notes))


def _start_conditions(log: Log, notes: list[str]) -> tuple[Params, Mode, Reference | None]:
    lacking = [name for name in REQUIRED_KEYS if name not in log.header]
    if lacking:
        raise BadJson(
            f"its header has no {', '.join(lacking)}, so nobody knows what flight software began with; "
            f"record it with this marsarm, or import it with a [start]"
        )
    written = _header_document(log, "params")
    seen = len(notes)
    params: Params = record_from_json(Params, written, "params", notes, nominal_params())
    if len(notes) == seen and digest(params) != log.header["params_sha256"]:
        raise BadJson(
            "its parameters do not match their own digest: the header was changed; "
            "give the log as it was written"
        )
    wrong = [*check_limits(params), *check_arm(params)]
    if wrong:
        raise BadJson(f"params: {wrong[0]}")
    boot = _header_document(log, "boot")
    if not isinstance(boot, dict) or not {"mode", "reference"} <= boot.keys():
        raise BadJson("boot: must be mode and reference")
    mode: Mode = record_from_json(Mode, boot["mode"], "boot.mode", notes)
    return params, mode, _decode_reference(boot["reference"], notes)


def _header_document(log: Log, name: str) -> Any:
    try:
        return json.loads(log.header[name])
    except ValueError as error:
        raise BadJson(f"{name}: is not JSON ({error}); give the log as it was written") from error


def _decode_reference(value: Any, notes: list[str]) -> Reference | None:
    if value is None:
        return None
    reference: Reference = record_from_json(Reference, value, "boot.reference", notes)
    for field in fields(reference):
        shape = getattr(reference, field.name).shape
        if shape != PER_JOINT:
            raise BadJson(f"boot.reference.{field.name}: has shape {shape}, {PER_JOINT} would be right")
    return reference


def _count_whole_ticks(log: Log, notes: list[str]) -> int:
    """How many ticks from 0 on are surely all there."""
    if SENSOR_TOPIC not in log.packets:
        raise NotReplayable(
            f"log {log.path}: has no {SENSOR_TOPIC}, so there is nothing to replay; give the log of a run"
        )
    ticks = log.ticks(SENSOR_TOPIC)
    if ticks[0] != 0:
        raise NotReplayable(
            f"log {log.path}: begins at tick {ticks[0]}; what flight software knew by then is unknown; "
            "give a log that begins at tick 0"
        )
    gaps = np.flatnonzero(np.diff(ticks) != 1)
    end = len(ticks) if gaps.size == 0 else int(gaps[0]) + 1
    notes += [f"recovered: {one.sentence}" for one in log.lost]
    end = min(
        end, *(_last_tick_before(one) + 1 for one in log.lost if one.topic in REQUIRED_TOPICS), len(ticks)
    )
    if end == len(ticks) and not log.truncated:
        return end
    if end == 1:
        raise NotReplayable(f"log {log.path}: holds no tick that is surely whole; give a longer log")
    why = "the log was cut short" if end == len(ticks) else f"something after tick {end - 1} is missing"
    notes.append(f"{why}: replayed up to tick {end - 2}, the last that is surely whole")
    return end - 1


def _last_tick_before(lost: LostMessages) -> int:
    """The tick of the last message of its topic before what was lost; with none, the first tick."""
    return 0 if lost.after_ns is None else lost.after_ns // TICK_NS


def _sensor_columns(log: Log) -> dict[str, NDArray[Any]]:
    """The columns of the sensor packets, each of the type and shape that flight software takes."""
    packets = log[SENSOR_TOPIC]
    columns = {}
    for field in packet_layout(Sensors, [field.name for field in fields(Sensors)]).fields:
        where = f"log {log.path}: {SENSOR_TOPIC}.{field.name}"
        if field.name not in (packets.dtype.names or ()):
            raise NotReplayable(
                f"{where} is missing; today's flight software reads it; "
                f"give a log that has all of {SENSOR_TOPIC}"
            )
        column = np.ascontiguousarray(packets[field.name])
        shape, dtype = field.shape or (), np.dtype(field.kind)
        if column.dtype != dtype or column.shape[1:] != shape:
            found = f"{column.dtype}{column.shape[1:]}"
            raise NotReplayable(f"{where} is {found}; flight software reads {dtype}{shape}")
        columns[field.name] = column
    return columns
