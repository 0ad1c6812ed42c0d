"""Strict parser of mappings in TOML: channels, [start], [[command]], [session]; it reports all problems."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar

import numpy as np

from fsw.config import CYCLE_HZ, configure
from fsw.dictionary.enums import Mode
from fsw.dictionary.params import Params
from fsw.dictionary.types import Joints5, Limits
from fsw.estimate.reference import Reference
from marsarm.telemetry.imports.files import BadImport
from marsarm.telemetry.imports.mapping import (
    TICK,
    CsvFormat,
    FlightStart,
    MappedChannel,
    SessionMapping,
    TableMapping,
    TimedCommand,
    TimeMapping,
)
from marsarm.telemetry.imports.targets import (
    IMPORT_PREFIX,
    ChannelTarget,
    conversions,
    custom_target,
    known_targets,
)
from marsarm.telemetry.imports.units import Conversion, known_units
from marsarm.telemetry.imports.values import convert_to_si
from sim.params import nominal_params, params_over_nominal
from sim.params_table import BadParams
from sim.scenario.records import Findings, did_you_mean, list_tables, read_record, require_table
from sim.scenario.tables import read_command
from simgap.common.errors import RobotError
from simgap.common.toml import KeyPath, key_path, parse_toml

Flags5 = tuple[bool, bool, bool, bool, bool]
COMMAND_ROUNDING: Final = 1e-6
"""Share of a cycle by which a command may follow the start of a cycle and still belong to it."""


@dataclass(frozen=True, slots=True)
class _Reference:
    """Table [start.reference]: stored reference of the joints, in the order of Joint."""

    calibrated: Flags5
    zero_rad: Joints5
    known: Flags5 | None = None
    half_backlash_rad: Joints5 | None = None
    resolver_bias_rad: Joints5 = (0.0, 0.0, 0.0, 0.0, 0.0)
    friction_Nm: Joints5 | None = None


@dataclass(frozen=True, slots=True)
class _Start:
    """Table [start] without the reference."""

    mode: Mode
    params: str | None = None


@dataclass(frozen=True, slots=True)
class _CommandTime:
    """Time of a command."""

    at_s: Annotated[float, Limits(0.0, 1e7)]


def parse_start(data: dict[str, Any], folder: Path, findings: Findings) -> FlightStart | None:
    """Parse [start] and [[command]]; None if there is no [start], or `findings` received a problem of it."""
    command_tables = list(list_tables(data, "command", findings))
    if "start" not in data:
        if command_tables:
            findings.report(("command",), "is for a table that is to be replayed; write [start] too")
        return None
    table = require_table(data["start"], ("start",), findings)
    if table is None:
        return None
    own = {key: value for key, value in table.items() if key != "reference"}
    start = read_record(_Start, own, ("start",), findings)
    params = None if start is None else _load_params(start.params, folder, findings)
    if start is None or params is None:
        return None
    reference = _parse_reference(table, params, findings)
    points = {point.name: point.tool for point in params.teach}
    commands = [_parse_command(table, place, findings, points, params) for place, table in command_tables]
    in_order = sorted((one for one in commands if one is not None), key=lambda one: one.tick)
    return FlightStart(params, start.mode, reference, tuple(in_order))


def _load_params(name: str | None, folder: Path, findings: Findings) -> Params | None:
    if name is None:
        return nominal_params()
    path = folder / name
    try:
        return params_over_nominal(path)
    except (BadParams, OSError, ValueError) as error:
        for line in str(error).splitlines():
            findings.report(("start", "params"), line)
    return None


def _parse_reference(table: dict[str, Any], params: Params, findings: Findings) -> Reference | None:
    """Parse the stored reference of the joints; None if there is none."""
    if "reference" not in table:
        return None
    place = ("start", "reference")
    inner = require_table(table["reference"], place, findings)
    fields = None if inner is None else read_record(_Reference, inner, place, findings)
    if fields is None:
        return None
    known = np.array(fields.calibrated if fields.known is None else fields.known)
    nominal_rad = configure(params).half_backlash_rad
    friction = np.zeros(known.size) if fields.friction_Nm is None else np.array(fields.friction_Nm)
    return Reference(
        calibrated=np.array(fields.calibrated),
        known=known,
        zero_rad=np.array(fields.zero_rad),
        half_backlash_rad=nominal_rad
        if fields.half_backlash_rad is None
        else np.array(fields.half_backlash_rad),
        resolver_bias_rad=np.array(fields.resolver_bias_rad),
        friction_Nm=np.where(known & (fields.friction_Nm is not None), friction, np.inf),
    )


def _parse_command(
    table: dict[str, Any],
    place: KeyPath,
    findings: Findings,
    points: Mapping[str, str],
    params: Params,
) -> TimedCommand | None:
    at = read_record(_CommandTime, {"at_s": table["at_s"]} if "at_s" in table else {}, place, findings)
    rest = {key: value for key, value in table.items() if key != "at_s"}
    command = read_command(rest, place, findings, points, params)
    if at is None or command is None:
        return None
    return TimedCommand(math.ceil(at.at_s * CYCLE_HZ - COMMAND_ROUNDING), command, place)


T = TypeVar("T")

KNOWN_KEYS: Final = ("arm", "time", "csv", "channel", "start", "command", "session")
LIST_KEYS: Final = ("columns", "gain", "offset")
"""Keys of a channel that may be a single value instead of a list."""
MAX_MAPPING_BYTES: Final = 1 << 20


@dataclass(frozen=True, slots=True)
class _Channel:
    """Table [[channel]] without its constant value."""

    name: str
    columns: tuple[str, ...] | None = None
    unit: str | None = None
    gain: tuple[float, ...] = (1.0,)
    offset: tuple[float, ...] = (0.0,)


@dataclass(frozen=True, slots=True)
class _Head:
    """Keys before the first table of a mapping."""

    arm: str = "unknown"


def parse_mapping(text: str, file: str, folder: Path) -> TableMapping:
    """Parse a mapping.

    Args:
        text: Mapping in TOML.
        file: Name of its file, for messages.
        folder: Folder from which paths in the mapping start.

    Raises:
        BadImport: the mapping is wrong; the message has every problem with its key.
    """
    if len(text) > MAX_MAPPING_BYTES:
        raise BadImport([f"{file}: has {len(text)} characters; a mapping has at most {MAX_MAPPING_BYTES}"])
    try:
        data = parse_toml(text, file)
    except RobotError as error:
        raise BadImport([str(error)]) from error
    findings = Findings()
    mapping = _parse_tables(data, file, folder, findings)
    if mapping is None or findings.problems:
        raise BadImport(f"{file}: {problem}" for problem in findings.problems)
    return mapping


def _parse_tables(data: dict[str, Any], file: str, folder: Path, findings: Findings) -> TableMapping | None:
    for key in data:
        if key not in KNOWN_KEYS:
            findings.report((key,), f"is not known here; {did_you_mean(key, KNOWN_KEYS)}")
    head = read_record(_Head, {key: data[key] for key in ("arm",) if key in data}, (), findings)
    time = _parse_table(TimeMapping, data, "time", findings)
    csv = _parse_table(CsvFormat, data, "csv", findings)
    channels = [
        _parse_channel(table, place, findings) for place, table in list_tables(data, "channel", findings)
    ]
    if not data.get("channel"):
        findings.report(("channel",), "is missing; write [[channel]] and its keys below, once for each")
    _check_mapped_once([channel for channel in channels if channel is not None], findings)
    start = parse_start(data, folder, findings)
    session = _parse_table(SessionMapping, data, "session", findings) if "session" in data else None
    if head is None or time is None or csv is None or None in channels:
        return None
    return TableMapping(
        file, head.arm, time, csv, tuple(c for c in channels if c is not None), start, session
    )


def _parse_table(kind: type[T], data: dict[str, Any], name: str, findings: Findings) -> T | None:
    table = require_table(data.get(name, {}), (name,), findings)
    return None if table is None else read_record(kind, table, (name,), findings)


def _parse_channel(table: dict[str, Any], place: KeyPath, findings: Findings) -> MappedChannel | None:
    before = len(findings.problems)
    listed = {k: [v] if k in LIST_KEYS and not isinstance(v, list) else v for k, v in table.items()}
    constant = listed.pop("value", None)
    fields = read_record(_Channel, listed, place, findings)
    if fields is None:
        return None
    if (fields.columns is None) == (constant is None):
        findings.report(
            place, f"{fields.name}: give columns, or value for what never changes; one of the two"
        )
        return None
    target = _find_target(fields, table, place, findings)
    if target is None:
        return None
    conversion = _find_conversion(fields, target, place, findings)
    gain, offset = (
        _per_column(name, getattr(fields, name), target, place, findings) for name in ("gain", "offset")
    )
    if fields.columns is not None:
        _check_columns(fields.columns, target, place, findings)
    if target.members is not None and (fields.gain, fields.offset) != ((1.0,), (0.0,)):
        findings.report(place, f"{target.name}: is a name; it has neither gain nor offset")
    parsed = None if constant is None else _parse_constant(constant, target, place, findings)
    if len(findings.problems) > before:
        return None
    channel = MappedChannel(target, fields.columns or (), parsed, conversion, gain, offset, place)
    _check_finite(channel, (*place, "value"), findings)
    return channel


def _check_finite(channel: MappedChannel, at: KeyPath, findings: Findings) -> None:
    """Refuse a constant that its gain, offset or unit makes infinite."""
    if not isinstance(channel.constant, np.ndarray) or channel.target.field.kind != "<f8":
        return
    with np.errstate(over="ignore", invalid="ignore"):
        is_finite = np.isfinite(convert_to_si(channel, channel.constant, slice(None))).all()
    if not is_finite:
        findings.report(at, "is too large for its gain, offset and unit; are they right?")


def _find_target(
    fields: _Channel, table: dict[str, Any], place: KeyPath, findings: Findings
) -> ChannelTarget | None:
    known = known_targets()
    if fields.name in known:
        return known[fields.name]
    at = (*place, "name")
    if not fields.name.startswith(IMPORT_PREFIX):
        findings.report(at, f"{fields.name!r} is not known; {_suggest_name(fields.name)}")
        return None
    if fields.unit is None or fields.unit not in known_units():
        findings.report((*place, "unit"), f"{_describe_unit(fields.unit, known_units())}")
        return None
    columns = fields.columns or ("value",)
    single = not isinstance(table.get("columns", table.get("value")), list)
    target = custom_target(fields.name, len(columns), fields.unit, single)
    if isinstance(target, ChannelTarget):
        return target
    findings.report(at, f"{fields.name}: {target}")
    return None


def _suggest_name(name: str) -> str:
    meant, _, _ = did_you_mean(name, known_targets()).rpartition("there are ")
    own = f"write {IMPORT_PREFIX}NAME.FIELD for one of your own"
    return f"{meant}`marsarm dictionary '/*'` lists our channels; {own}"


def _find_conversion(
    fields: _Channel, target: ChannelTarget, place: KeyPath, findings: Findings
) -> Conversion:
    at = (*place, "unit")
    if target.members is not None:
        if fields.unit is not None:
            findings.report(at, f"{target.name} is a name or its number; leave it out")
        return Conversion()
    known = conversions(target.unit or "1")
    if fields.unit is None and target.unit in ("bool", "cycle", "count", "1"):
        return Conversion()  # nothing else could be meant
    if fields.unit not in known:
        findings.report(
            at, f"{_describe_unit(fields.unit, known)}; {target.name} is kept in {target.unit}"
        )
        return Conversion()
    return known[fields.unit]


def _describe_unit(unit: str | None, known: Any) -> str:
    if unit is None:
        return f"is missing; there are {', '.join(known)}"
    return f"{unit!r} does not fit; {did_you_mean(unit, known)}"


def _per_column(
    name: str, values: tuple[float, ...], target: ChannelTarget, place: KeyPath, findings: Findings
) -> Any:
    if len(values) not in (1, target.size):
        findings.report(
            (*place, name),
            f"{len(values)} given; {target.name} takes one for all, or {target.columns_text}",
        )
        return np.ones(target.size)
    return np.broadcast_to(np.array(values, np.float64), (target.size,))


def _check_columns(
    columns: tuple[str, ...], target: ChannelTarget, place: KeyPath, findings: Findings
) -> None:
    at = (*place, "columns")
    if len(columns) != target.size:
        findings.report(at, f"{len(columns)} given; {target.name} takes {target.columns_text}")
    for name in sorted({name for name in columns if columns.count(name) > 1}):
        findings.report(at, f"{name!r} is there twice; each number has a column of its own")


def _parse_constant(value: Any, target: ChannelTarget, place: KeyPath, findings: Findings) -> Any:
    """Parse a constant, one value for each element; TICK stands for the number of the cycle."""
    at = (*place, "value")
    if value == TICK and target.unit == "cycle":
        return TICK
    items = value if isinstance(value, list) else [value] * target.size
    if len(items) != target.size:
        findings.report(at, f"{len(items)} given; {target.name} takes {target.columns_text}")
        return None
    problem = next((p for p in (_check_value(item, target) for item in items) if p is not None), None)
    if problem is not None:
        findings.report(at, f"{problem}")
        return None
    if target.members is not None:
        items = [target.member(item) for item in items]
    return np.array(items, np.dtype(target.field.kind) if target.field.kind != "<f8" else np.float64)


def _check_value(item: Any, target: ChannelTarget) -> str | None:
    match target.field.kind:
        case _ if target.members is not None:
            if isinstance(item, str) and target.member(item) is not None:
                return None
            hint = did_you_mean(item, target.members)
            return f"{item!r:.60} is not known; {hint}"
        case "|b1":
            return None if isinstance(item, bool) else f"{item!r:.60} is not true or false"
        case "<i8" if type(item) is int and abs(item) < 1 << 63:
            return None
        case "<i8":
            also = ', or "tick" for the number of the cycle' if target.unit == "cycle" else ""
            return f"{item!r:.60} is not a whole number of 64 bits{also}"
        case _:
            number = isinstance(item, int | float) and not isinstance(item, bool)
            if number and abs(item) < 1e300 and math.isfinite(item):
                return None
            return f"{item!r:.60} is not a finite number"


def _check_mapped_once(channels: list[MappedChannel], findings: Findings) -> None:
    """Refuse a channel that is mapped twice."""
    seen: dict[str, KeyPath] = {}
    for channel in channels:
        name = channel.target.name.lower()
        if name in seen:
            where = key_path(seen[name])
            findings.report(
                channel.place, f"{channel.target.name}: is mapped by {where} already; map it once"
            )
        seen.setdefault(name, channel.place)
