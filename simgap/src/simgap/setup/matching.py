"""Columns that belong to the joints of a model, found by names and order."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from simgap.files.columns import ColumnInfo
from simgap.setup.column_names import ColumnName, parse_name

MODES: Final = ("position", "velocity", "torque", "current", "voltage")
"""Signals that may be commanded; where a log has several, the first is what the outer loop was told."""
MOVING: Final = ("secondary", "velocity", "torque", "current")
"""Signals that are absent where they are constant: drivers fill their columns with zeros."""
FREE_BASE: Final = (6, 7)
"""Numbers of a free base before those of the joints: of its velocity and its position."""


@dataclass(frozen=True, slots=True)
class Match:
    """Column that is taken for a signal of a joint."""

    info: ColumnInfo
    name: ColumnName
    reason: str


@dataclass(frozen=True, slots=True)
class Matches:
    """Columns by joint and key, and doubts."""

    by_joint: Mapping[str, Mapping[str, Match]]
    questions: tuple[str, ...]


def match_columns(
    columns: Iterable[ColumnInfo], joints: Sequence[str], driven: Sequence[str], others: Sequence[str]
) -> Matches:
    """Find the columns of joints: by name, as the only joint, or by order.

    Args:
        joints: Hinges and slides of the model, in its order.
        driven: Those that an actuator drives.
        others: Columns that are known to be none of a joint.
    """
    found: dict[tuple[str, str], list[Match]] = defaultdict(list)
    numbered: dict[str, list[tuple[ColumnInfo, ColumnName]]] = defaultdict(list)
    for info in columns:
        name = parse_name(info.name, joints)
        if info.name in others or info.lowest is None or info.kind == "time" or not name.key:
            continue  # a column that never has a number is one that a driver does not fill
        if name.key in MOVING and info.lowest == info.highest:
            continue
        if name.joint:
            found[name.joint, name.key].append(Match(info, name, "by name"))
        elif len(joints) == 1:
            found[joints[0], name.key].append(Match(info, name, "the model has one joint"))
        elif name.index >= 0:
            numbered[name.group].append((info, name))
    questions: dict[str, None] = {}
    ordered: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for group in numbered.values():
        group.sort(key=lambda pair: pair[1].index)
        if len(group) - len(joints) in FREE_BASE:
            group = group[-len(joints) :]
        stem = group[0][0].name.rstrip("0123456789[]").rstrip("._/")
        by_actuator = group[0][1].key == "command" or len(group) != len(joints)
        order = driven if by_actuator and len(group) == len(driven) else joints
        if len(group) != len(order):
            names = ", ".join(joints)
            question = f"{stem} has {len(group)} numbers, the model has the joints {names}: which is which?"
            questions[question] = None
        if len(group) > len(order):
            continue
        taken = order[: len(group)]
        ordered[tuple(taken)].append(stem)
        for joint, (info, name) in zip(taken, group, strict=True):
            found[joint, name.key].append(Match(info, name, "by order"))
    for taken, stems in ordered.items():
        questions[f"is {', '.join(taken)} the order of the joints in {', '.join(stems)}?"] = None
    by_joint: dict[str, dict[str, Match]] = {joint: {} for joint in joints}
    for (joint, key), matches in found.items():
        matches.sort(key=_rank)
        by_joint[joint][key] = matches[0]
        rest = [one.info.name for one in matches[1:] if one.name.signal == matches[0].name.signal]
        if rest:
            questions[f"{matches[0].info.name} is the {key} of {joint}; or is it {' or '.join(rest)}?"] = None
    return Matches({joint: own for joint, own in by_joint.items() if "position" in own}, tuple(questions))


def _rank(one: Match) -> tuple[int, int, int]:
    """Order columns of one key: what the outer loop was told first, then sure names, then short ones."""
    order = (*MODES, "").index(one.name.signal) if one.name.key == "command" else 0
    return order, ("by name", "the model has one joint", "by order").index(one.reason), len(one.info.name)
