"""Inputs and outputs of flight software in a run: start, sensors and commands; packets and events."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from operator import attrgetter
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.commands import Command
from fsw.dictionary.enums import Mode
from fsw.dictionary.params import Params, digest
from fsw.dictionary.validity import check_arm, check_limits
from fsw.estimate.reference import Reference
from fsw.messages import Outputs, Sensors
from marsarm.telemetry.events import BadJson, EvrEntry, command_from_json, evr_entry, record_from_json
from marsarm.telemetry.format import COMMAND_TOPIC, SENSOR_TOPIC, TICK_NS, trailing_bytes_text
from marsarm.telemetry.read import Log
from marsarm.telemetry.schema import PER_JOINT, ArmNames, arm_names, packet_layout
from marsarm.telemetry.topics import PACKET_TOPICS, Topic
from sim.arms import nominal_params
from simgap.common.errors import BadRequest

REQUIRED_TOPICS: Final = (None, SENSOR_TOPIC, COMMAND_TOPIC)
"""Topics whose loss ends a replay, None for an unknown topic; a loss of others is a difference of length."""
REQUIRED_KEYS: Final = ("params", "params_sha256", "boot")


class NotReplayable(BadRequest):
    """Error of a log that cannot be replayed; the message says why."""


@dataclass(frozen=True, slots=True, eq=False)
class Inputs:
    """Inputs of flight software from its first cycle on."""

    params: Params
    mode: Mode
    reference: Reference | None
    sensors: Mapping[str, NDArray[Any]]
    """Values by field of Sensors, one row for each tick, shape (ticks, ...)."""
    commands: Mapping[int, tuple[Command, ...]]
    """Commands by tick."""
    ticks: int
    notes: tuple[str, ...]
    """Sentences about inputs that differ from those of the run."""

    def sensors_at(self, tick: int) -> Sensors:
        """Return the readings of one cycle; arrays are copies."""
        row: dict[str, Any] = {name: values[tick] for name, values in self.sensors.items()}
        row = {n: v.copy() if isinstance(v, np.ndarray) else v.item() for n, v in row.items()}
        return Sensors(**row)


def inputs_from_log(log: Log) -> Inputs:
    """Return the inputs of flight software in a log; NotReplayable if it lacks one, or has one not known.

    If the log is truncated or messages are missing, they end with the last tick that is complete.
    """
    notes: list[str] = [] if not log.trailing_bytes else [trailing_bytes_text(log.trailing_bytes)]
    if log.interrupted_by:
        notes.append(log.end_note)
    try:
        params, mode, reference = _start_conditions(log, notes)
        commands: dict[int, tuple[Command, ...]] = {}
        for entry in log.commands:
            command = command_from_json(entry.name, entry.fields, notes)
            commands[entry.tick] = (*commands.get(entry.tick, ()), command)
    except (BadJson, ValueError, RecursionError) as error:
        raise NotReplayable(f"log {log.path}: {error}") from error
    ticks = _count_whole_ticks(log, notes)
    return Inputs(
        params, mode, reference, _sensor_columns(log, arm_names(params)), commands, ticks, tuple(notes)
    )


def _start_conditions(log: Log, notes: list[str]) -> tuple[Params, Mode, Reference | None]:
    lacking = [name for name in REQUIRED_KEYS if name not in log.header]
    if lacking:
        raise BadJson(
            f"its header has no {', '.join(lacking)}, so its start conditions are unknown; "
            f"record it with this marsarm, or import it with a [reference]"
        )
    document = _header_document(log, "params")
    count = len(notes)
    params: Params = record_from_json(Params, document, "params", notes, nominal_params())
    if len(notes) == count and digest(params) != log.header["params_sha256"]:
        raise BadJson(
            "its parameters do not match their own digest: the header was changed; "
            "give the log as it was written"
        )
    problems = [*check_limits(params), *check_arm(params)]
    if problems:
        raise BadJson(f"params: {problems[0]}")
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
    """Count the ticks from 0 on that are complete."""
    if SENSOR_TOPIC not in log.packets:
        raise NotReplayable(
            f"log {log.path}: has no {SENSOR_TOPIC}, so there is nothing to replay; give the log of a run"
        )
    ticks = log.ticks(SENSOR_TOPIC)
    if ticks[0] != 0:
        raise NotReplayable(
            f"log {log.path}: begins at tick {ticks[0]}; the state of flight software there is unknown; "
            "give a log that begins at tick 0"
        )
    breaks = np.flatnonzero(np.diff(ticks) != 1)
    end = len(ticks) if breaks.size == 0 else int(breaks[0]) + 1
    notes += [f"recovered: {one.sentence}" for one in log.lost]
    lost = [one for one in log.lost if one.topic in REQUIRED_TOPICS]
    end = min(end, *((one.after_ns or 0) // TICK_NS + 1 for one in lost), len(ticks))
    if end == len(ticks) and not log.truncated:
        return end
    if end == 1:
        raise NotReplayable(f"log {log.path}: holds no tick that is surely complete; give a longer log")
    why = "the log was cut short" if end == len(ticks) else f"something after tick {end - 1} is missing"
    notes.append(f"{why}: replayed up to tick {end - 2}, the last that is surely complete")
    return end - 1


def _sensor_columns(log: Log, arm: ArmNames) -> dict[str, NDArray[Any]]:
    """Return the fields of the sensor packets, and check type and shape of each."""
    packets = log[SENSOR_TOPIC]
    columns = {}
    for field in packet_layout(Sensors, [field.name for field in fields(Sensors)], arm).fields:
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


OUTPUTS_PREFIX: Final = "outputs."
OUTPUT_TOPICS: Final[tuple[Topic, ...]] = tuple(
    topic for topic in PACKET_TOPICS.values() if topic.path.startswith(OUTPUTS_PREFIX)
)


@dataclass(frozen=True, slots=True, eq=False)
class TopicSeries:
    """Packets of one topic."""

    ticks: NDArray[np.int64]
    """Tick of each packet, rising, shape (n,)."""
    fields: Mapping[str, NDArray[Any]]
    """Values by field, shape (n, ...)."""


@dataclass(frozen=True, slots=True, eq=False)
class Behaviour:
    """Outputs of flight software in a run; topics without packets are absent."""

    ticks: int
    """Number of cycles, from tick 0."""
    series: Mapping[str, TopicSeries]
    evrs: tuple[EvrEntry, ...]


def behaviour_from_log(log: Log, ticks: int) -> Behaviour:
    """Return the outputs in a log, up to a number of ticks."""
    series = {}
    for topic in OUTPUT_TOPICS:
        if topic.name in log.packets:
            end = int(np.searchsorted(log.ticks(topic.name), ticks))
            packets = log[topic.name][:end]
            names = [name for name in topic.field_names if name in (packets.dtype.names or ())]
            series[topic.name] = TopicSeries(
                log.ticks(topic.name)[:end], {name: packets[name] for name in names}
            )
    evrs = tuple(evr for evr in log.evrs if evr.tick < ticks)
    return Behaviour(ticks, series, evrs)


def behaviour_from_outputs(outputs: Sequence[Outputs]) -> Behaviour:
    """Return the outputs of a run, given for each cycle from tick 0."""
    series = {}
    for topic in OUTPUT_TOPICS:
        packet_of = attrgetter(topic.path.removeprefix(OUTPUTS_PREFIX))
        packets = [
            (tick, packet) for tick, out in enumerate(outputs) if (packet := packet_of(out)) is not None
        ]
        if packets:
            ticks = np.array([tick for tick, _ in packets], np.int64)
            columns = {
                name: np.array([getattr(packet, name) for _, packet in packets]) for name in topic.field_names
            }
            series[topic.name] = TopicSeries(ticks, columns)
    evrs = tuple(evr_entry(tick, evr) for tick, out in enumerate(outputs) for evr in out.evrs)
    return Behaviour(len(outputs), series, evrs)
