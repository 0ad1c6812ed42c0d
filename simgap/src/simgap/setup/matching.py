"""Columns that belong to the joints of a model, found by names and order."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from simgap.files.columns import ColumnInfo
from simgap.setup.column_names import ColumnName, parse_name

MODES: Final = ("position", "velocity", "torque", "current", "voltage")
"""Signals that may be commanded; where a log has several, the first is what the outer loop was told."""
MOVING: Final = ("secondary", "velocity", "torque", "current")
"""Signals that are absent where they are constant: drivers fill their columns with zeros."""
FREE_BASE: Final = (6, 7)
"""Numbers of a free base before those of the joints: of its velocity and its position."""
Column = tuple[ColumnInfo, ColumnName]


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
    still: tuple[str, ...]
    """Columns of signals that never change: they are left away."""


def match_columns(
    columns: Iterable[ColumnInfo],
    joints: Sequence[str],
    driven: Sequence[str],
    others: Sequence[str],
    records: Mapping[str, str],
) -> Matches:
    """Find the columns of joints: by name, as the only joint, or by order.

    Args:
        joints: Hinges and slides of the model, in its order.
        driven: Those that an actuator drives.
        others: Columns that are known to be none of a joint.
        records: Joints by the beginning of the names of their columns, such as `joints[0].`.
    """
    groups = _Groups()
    for info in columns:
        name = parse_name(info.name, joints)
        record = next((one for one in records if info.name.startswith(one)), "")
        if record:
            name = replace(name, joint=records[record])
        if name.key and info.name not in others and info.kind != "time":
            groups.add(info, name, joints)
    questions, found = groups.questions, groups.found
    if not any(key == "position" for _, key in found) and not groups.numbered:
        groups.numbered |= groups.unnamed  # names of another robot, in the order of the joints
    _match_by_order(groups, joints, driven)
    by_joint: dict[str, dict[str, Match]] = {joint: {} for joint in joints}
    for (joint, key), matches in found.items():
        matches.sort(key=_rank)
        by_joint[joint][key] = matches[0]
        rest = [one.info.name for one in matches[1:] if one.name.signal == matches[0].name.signal]
        if rest:
            questions[f"{matches[0].info.name} is the {key} of {joint}; or is it {' or '.join(rest)}?"] = None
    shown = {joint: own for joint, own in by_joint.items() if "position" in own}
    return Matches(shown, tuple(questions), tuple(groups.still))


@dataclass(slots=True)
class _Groups:
    """Columns in groups of one kind."""

    found: dict[tuple[str, str], list[Match]] = field(default_factory=lambda: defaultdict(list))
    """Those of a joint and a key."""
    numbered: dict[str, list[Column]] = field(default_factory=lambda: defaultdict(list))
    unnamed: dict[str, list[Column]] = field(default_factory=lambda: defaultdict(list))
    """Those without a number and a joint, by key."""
    still: list[str] = field(default_factory=list)
    questions: dict[str, None] = field(default_factory=dict)

    def add(self, info: ColumnInfo, name: ColumnName, joints: Sequence[str]) -> None:
        """Put a column with a key into its group."""
        if info.kind == "text" and name.joint and name.key in ("position", "command"):
            self.questions[f"{info.name} holds texts: are they numbers? Write them as such"] = None
        if info.lowest is None:
            return  # a column that never has a number is one that a driver does not fill
        if name.key in MOVING and info.lowest == info.highest:
            self.still += [info.name] * bool(name.joint or name.index >= 0)
        elif name.joint:
            self.found[name.joint, name.key].append(Match(info, name, "by name"))
        elif len(joints) == 1:
            self.found[joints[0], name.key].append(Match(info, name, "the model has one joint"))
        elif name.index >= 0:
            self.numbered[name.group].append((info, name))
        else:
            self.unnamed[name.key].append((info, name))


def _match_by_order(groups: _Groups, joints: Sequence[str], driven: Sequence[str]) -> None:
    """Give the columns of numbered groups to the joints in order, and ask whether it is theirs."""
    ordered: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for group in groups.numbered.values():
        group.sort(key=lambda pair: pair[1].index)  # -1 for all without a number, which stay in order
        if len(group) - len(joints) in FREE_BASE:
            group = group[-len(joints) :]
        stem = group[0][0].name.rstrip("0123456789[]").rstrip("._/")
        if group[0][1].index < 0:
            stem = ", ".join(info.name for info, _ in group)
        by_actuator = group[0][1].key == "command" or len(group) != len(joints)
        order = driven if by_actuator and len(group) == len(driven) else joints
        if len(group) != len(order):
            names = ", ".join(joints)
            question = f"{stem} has {len(group)} numbers, the model has the joints {names}: which is which?"
            groups.questions[question] = None
        if len(group) > len(order):
            continue
        taken = order[: len(group)]
        ordered[tuple(taken)].append(stem)
        for joint, (info, name) in zip(taken, group, strict=True):
            groups.found[joint, name.key].append(Match(info, name, "by order"))
    for taken, stems in ordered.items():
        groups.questions[f"is {', '.join(taken)} the order of the joints in {', '.join(stems)}?"] = None


def _rank(one: Match) -> tuple[int, int, int]:
    """Order columns of one key: what the outer loop was told first, then sure names, then short ones."""
    order = (*MODES, "").index(one.name.signal) if one.name.key == "command" else 0
    return order, ("by name", "the model has one joint", "by order").index(one.reason), len(one.info.name)
