"""Split files: which motions are fitted, and which only judge."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field, model_validator

from simgap.common.errors import RobotError
from simgap.common.record import Record
from simgap.common.toml import parse_record, read_toml
from simgap.files.columns import hint_at


class SplitTable(Record):
    """One split: parts that are fitted, and parts that judge."""

    fit: list[str] = Field(default_factory=list)
    """Parts that are fitted; none: all that is not held out."""
    held_out: Annotated[list[str], Field(min_length=1)]
    """Parts that take no part in a fit."""


class SplitFile(Record):
    """Content of a split file."""

    default: str
    """Split that is taken if none is named."""
    parts: dict[str, Annotated[list[str], Field(min_length=1)]]
    """Part -> its motions, or the conditions or files whose motions it has."""
    splits: dict[str, SplitTable]
    """Name of a split -> what it fits and what it holds out."""

    @model_validator(mode="after")
    def _check(self) -> "SplitFile":
        if self.default not in self.splits:
            raise ValueError(f"default: there is no split {self.default!r}{_near(self.default, self.splits)}")
        for name, split in self.splits.items():
            for part in (*split.fit, *split.held_out):
                if part not in self.parts:
                    raise ValueError(f"splits.{name}: there is no part {part!r}{_near(part, self.parts)}")
        return self


@dataclass(frozen=True, slots=True)
class Member:
    """Names by which a split may refer to a motion."""

    motion: str
    others: tuple[str, ...]
    """Its name in its file, its file, and its conditions, as `mass_kg=0.5`."""


def read_split(path: Path) -> SplitFile:
    """Read a split file; RobotError if it cannot be read, or a key or a value is wrong."""
    return parse_record(SplitFile, read_toml(path), path)


def choose_motions(
    file: SplitFile | None, members: Sequence[Member], split: str, held_out: Sequence[str]
) -> tuple[frozenset[str], frozenset[str]]:
    """Return the names of fitted and of judging motions; RobotError if one is in both, or none is fitted."""
    everything = frozenset(one.motion for one in members)
    if held_out:
        judged = find_members(held_out, members, "held out")
        fitted = everything - judged
    elif file is None:
        if split:
            raise RobotError(f"split {split!r}: the robot file names no split file; add the key split to it")
        return everything, frozenset()
    else:
        name = split or file.default
        if name not in file.splits:
            raise RobotError(
                f"split {name!r}: the split file has none of this name{_near(name, file.splits)}"
            )
        table = file.splits[name]
        judged = _part_members(file, table.held_out, members)
        fitted = _part_members(file, table.fit, members) if table.fit else everything - judged
        both = sorted(fitted & judged)
        if both:
            raise RobotError(
                f"split {name!r}: motion {both[0]!r} is both fitted and held out; leave it in one part"
            )
    if not fitted:
        raise RobotError("split: all motions are held out, so that nothing is fitted; hold out fewer")
    return fitted, judged


def _part_members(file: SplitFile, parts: Sequence[str], members: Sequence[Member]) -> frozenset[str]:
    return frozenset().union(*(find_members(file.parts[part], members, f"part {part}") for part in parts))


def find_members(names: Sequence[str], members: Sequence[Member], where: str) -> frozenset[str]:
    """Return the motions with these names, conditions or files; RobotError if a name is unknown."""
    found: set[str] = set()
    for name in names:
        chosen = {one.motion for one in members if name and name in (one.motion, *one.others)}
        if not chosen:
            there = dict.fromkeys(text for one in members for text in (one.motion, *one.others))
            raise RobotError(
                f"{where}: {name!r} is no motion, condition or file of these logs{_near(name, there)}"
            )
        found |= chosen
    return frozenset(found)


def _near(name: str, there: Collection[str]) -> str:
    if "," in name and all(part.strip() in there for part in name.split(",")):
        return "; name each by itself: --held-out A --held-out B, or ['A', 'B'] in Python and files"
    return f"; {hint_at(name, [one for one in there if one], 'there are')}"
