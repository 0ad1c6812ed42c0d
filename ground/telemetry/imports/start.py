"""What flight software began with and was asked, as a mapping says: the tables [start] and [[command]]."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np

from fsw.config import CYCLE_HZ, configure
from fsw.dictionary.enums import Joint, Mode, Tool
from fsw.dictionary.params import Params
from fsw.dictionary.types import Joints5, Limits
from fsw.estimate.reference import Reference
from fsw.executive.expansion import teach_point_tool
from ground.telemetry.imports.mapping import Asked, Start
from sim.params import BadParams, nominal_params, params_over_nominal
from sim.scenario.toml_lines import TomlPath
from sim.scenario.toml_record import Findings, read_record, require_table
from sim.scenario.toml_tables import list_tables, read_command

Flags5 = tuple[bool, bool, bool, bool, bool]
NONE: Final = (0.0,) * len(Joint)
ROUNDING: Final = 1e-6
"""Of a cycle; a command this little after one is seen in it."""


@dataclass(frozen=True, slots=True)
class _Reference:
    """The table [start.reference]: what was remembered of the joints; order of Joint."""

    calibrated: Flags5
    zero_rad: Joints5
    known: Flags5 | None = None
    half_gap_rad: Joints5 | None = None
    resolver_bias_rad: Joints5 = (0.0, 0.0, 0.0, 0.0, 0.0)
    friction_Nm: Joints5 | None = None


@dataclass(frozen=True, slots=True)
class _Start:
    """The table [start] but for the reference."""

    mode: Mode
    params: str | None = None


@dataclass(frozen=True, slots=True)
class _At:
    """When a command is given."""

    at_s: Annotated[float, Limits(0.0, 1e7)]


def start_of(data: dict[str, Any], folder: Path, findings: Findings) -> Start | None:
    """What flight software began with; None where the mapping does not say, or says it wrongly."""
    asked = list(list_tables(data, "command", findings))
    if "start" not in data:
        if asked:
            findings.report(("command",), "command: is for a table that is to be replayed; write [start] too")
        return None
    table = require_table(data["start"], ("start",), findings)
    if table is None:
        return None
    own = {key: value for key, value in table.items() if key != "reference"}
    if isinstance(own.get("mode"), str):
        own["mode"] = own["mode"].lower()  # as names in columns, in capitals or not
    start = read_record(_Start, own, ("start",), findings)
    params = None if start is None else _params(start.params, folder, findings)
    if start is None or params is None:
        return None
    reference = _reference(table, params, findings)
    points = {point.name: teach_point_tool(point) for point in params.teach}
    commands = [_command(table, place, findings, points) for place, table in asked]
    in_order = sorted((one for one in commands if one is not None), key=lambda one: one.tick)
    return Start(params, start.mode, reference, tuple(in_order))


def _params(name: str | None, folder: Path, findings: Findings) -> Params | None:
    if name is None:
        return nominal_params()
    path = folder / name
    try:
        return params_over_nominal(path)
    except (BadParams, OSError, ValueError) as error:
        for line in str(error).splitlines():
            findings.report(("start", "params"), f"params: {line}")
    return None


def _reference(table: dict[str, Any], params: Params, findings: Findings) -> Reference | None:
    """What was remembered; None for nothing."""
    if "reference" not in table:
        return None
    place = ("start", "reference")
    inner = require_table(table["reference"], place, findings)
    said = None if inner is None else read_record(_Reference, inner, place, findings)
    if said is None:
        return None
    known = np.array(said.calibrated if said.known is None else said.known)
    drawn = configure(params).half_gap_rad
    friction = np.zeros(known.size) if said.friction_Nm is None else np.array(said.friction_Nm)
    return Reference(
        calibrated=np.array(said.calibrated),
        known=known,
        zero_rad=np.array(said.zero_rad),
        half_gap_rad=drawn if said.half_gap_rad is None else np.array(said.half_gap_rad),
        resolver_bias_rad=np.array(said.resolver_bias_rad),
        friction_Nm=np.where(known & (said.friction_Nm is not None), friction, np.inf),
    )


def _command(
    table: dict[str, Any], place: TomlPath, findings: Findings, points: Mapping[str, Tool]
) -> Asked | None:
    at = read_record(_At, {"at_s": table["at_s"]} if "at_s" in table else {}, place, findings)
    rest = {key: value for key, value in table.items() if key != "at_s"}
    command = read_command(rest, place, findings, points)
    if at is None or command is None:
        return None
    return Asked(math.ceil(at.at_s * CYCLE_HZ - ROUNDING), command, findings.lines[place])
