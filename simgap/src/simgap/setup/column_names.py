"""Columns that belong to the joints of a model, found by their names, which are taken apart, and by order."""

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from simgap.files.columns import ColumnInfo
from simgap.files.robot_file import SIGNALS
from simgap.units import UNITS, Quantity

WORD: Final = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+|[^\W\d_A-Za-z]+")
"""Words in camel case, numbers, and letters of other alphabets."""


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


COMMAND: Final = _words(
    "command commands cmd commanded goal target targets desired des ref reference setpoint action actions "
    "ctrl control c u"
)
"""Words of a signal that was sent to the robot."""
SIGNAL_WORDS: Final = {
    "enabled": _words("enable enabled"),
    "gain": _words("kp gain"),
    "velocity": _words("velocity velocities vel speed qvel qd dq v"),
    "torque": _words("torque torques tau effort efforts trq force"),
    "voltage": _words("voltage"),
    "temperature": _words("temperature temp"),
    "position": _words("position positions pos angle angles qpos q p encoder enc"),
    "current": _words("current currents cur i"),
}
"""Words of each signal, the surest first: the current position is no current."""
MEASURED: Final = _words("state act actual present measured meas")
"""Words of a position, if no other word and no letter says a signal."""
SECONDARY: Final = _words("secondary se second output link")
TIMES: Final = ("t", "time", "timestamp", "stamp", "clock")
REPEATS: Final = _words("repeat repeats repetition repeated")
MOTIONS: Final = ("motion", "episode", "trial", "run", "log", "trajectory", "experiment", "segment")
UNCLEAR: Final = _words(
    "raw rel simple load error err kd ki std header acceleration accelerations accel acc ddq qdd qacc jerk"
)
"""Words of a signal whose unit or meaning is not known, or that is none of a joint: it is not taken."""
UNIT_WORDS: Final = (
    {"degrees": "deg", "degree": "deg", "radians": "rad", "radian": "rad", "turns": "turn"}
    | {"counts": "count", "ticks": "count", "amps": "a", "volts": "v"}
    | {"seconds": "s", "secs": "s", "sec": "s", "nanoseconds": "ns"}
)
SIGNAL_OF: Final = {
    quantity: key for key, own in SIGNALS.items() if key not in ("secondary", "enabled") for quantity in own
} | {Quantity.TIME: "time"}
"""Signal that a unit of a quantity belongs to."""


@dataclass(frozen=True, slots=True)
class ColumnName:
    """Name of a column, taken apart."""

    name: str
    joint: str
    """Joint of the model that stands in it; empty if none does."""
    group: str
    """Its other words and numbers, with the last number, if no joint stands in it, as #."""
    index: int
    """That number; -1 if there is none."""
    signal: str
    """Signal, such as "position"; empty if no word says it, as in `action`."""
    is_command: bool
    key: str
    """Key of a joint in the robot file that such a column may have; empty for none."""
    unit: str
    """Unit that stands at the end; empty if none does."""


def split_words(name: str) -> tuple[str, ...]:
    """Return the words and numbers of a name, in small letters."""
    return tuple(word.lower() for word in WORD.findall(name))


def _unit_forms() -> dict[tuple[str, ...], str]:
    """Return each way in which a unit may stand in a name, as words."""
    forms: dict[tuple[str, ...], str] = {}
    for unit, one in UNITS.items():
        if one.quantity in SIGNAL_OF and unit != "h":
            parts = tuple(part.lower() for part in re.split("[/ ]", unit))
            for form in (parts, ("".join(parts),), split_words(unit)):
                forms.setdefault(form, unit)
            if "/" in unit:
                forms.setdefault((parts[0], "per", *parts[1:]), unit)
    return forms


UNIT_FORMS: Final = _unit_forms()


def parse_name(name: str, joints: Sequence[str]) -> ColumnName:
    """Take the name of a column of a robot with these joints apart."""
    words = split_words(name)
    joint, rest = take_joint(words, joints)
    number = max((k for k, word in enumerate(rest) if word.isdecimal()), default=-1)
    index = -1
    if not joint and number >= 0:
        index, rest = int(rest[number]), (*rest[:number], "#", *rest[number + 1 :])
    own = [UNIT_WORDS.get(word, word) for word in rest if word != "#"]
    size, unit = _find_unit(own)
    there = own[: len(own) - size]
    signal = _find_signal(there)
    if unit:
        of_unit = SIGNAL_OF[UNITS[unit].quantity]
        if signal != of_unit and len(unit) == 1:
            unit, there = "", own  # a single letter is more often part of a name
            signal = _find_signal(there)
        elif signal == "velocity" and of_unit == "position":
            unit = f"{unit}/s"  # deg is short for deg/s
        else:
            signal = of_unit
        unit = unit if unit in UNITS and unit != "count/s" else ""  # which needs the counts of a turn
    is_command = bool(COMMAND & set(there))
    key = "command" if is_command else signal
    if key == "position" and SECONDARY & set(there):
        key = "secondary"
    is_state = is_command and signal in ("gain", "enabled", "temperature")
    if UNCLEAR & set(own) or signal == "time" or is_state:
        key = ""
    return ColumnName(name, joint, " ".join(rest), index, signal, is_command, key, unit)


def take_joint(words: tuple[str, ...], joints: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    """Take the words of the joint with the longest part in a name out of it; of none if several have it.

    Words that all joints share, such as "joint", may be missing, if more than a number is left.
    """
    every = [set(split_words(joint)) for joint in joints]
    shared = set.intersection(*every) if len(every) > 1 else set()
    found: dict[str, tuple[int, int]] = {}
    for joint in joints:
        own = split_words(joint)
        short = tuple(word for word in own if word not in shared and word != "joint")
        for form in (own, *([short] if any(not word.isdecimal() for word in short) else [])):
            at = [k for k in range(len(words)) if form and words[k : k + len(form)] == form]
            if at:
                found[joint] = (at[-1], len(form))
                break
    longest = max((size for _, size in found.values()), default=0)
    best = [joint for joint, (_, size) in found.items() if size == longest]
    if len(best) != 1:
        return "", words
    first, size = found[best[0]]
    return best[0], words[:first] + words[first + size :]


def _find_signal(words: Sequence[str]) -> str:
    """Return the signal that words name; a word says more than a letter."""
    for is_long in (True, False):
        there = {word for word in words if (len(word) > 1) == is_long}
        found = next((signal for signal, known in SIGNAL_WORDS.items() if known & there), "")
        if found or (COMMAND & there and is_long):
            return found
    return "position" if MEASURED & set(words) else ""


def _find_unit(words: Sequence[str]) -> tuple[int, str]:
    """Return how many words at the end are a unit, and which; at least one word stands before them."""
    for size in (3, 2, 1):
        unit = UNIT_FORMS.get(tuple(words[len(words) - size :])) if size < len(words) else None
        if unit is not None:
            return size, unit
    return 0, ""


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
