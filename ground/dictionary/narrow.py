"""The part of the dictionary that a pattern names."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import TypeVar

from ground.common.requests import BadRequest
from ground.dictionary.entries import CommandEntry, Dictionary, Entry
from ground.telemetry.channel_name import channel_name, is_channel_meant
from sim.scenario.names import did_you_mean

E = TypeVar("E", bound=Entry)


def narrowed(whole: Dictionary, pattern: str) -> Dictionary:
    """The entries whose names match, whole, and of the others the fields that do; capitals do not count.

    A field is called by its own name or after its entry's, as /sensors.current_A or /sensors/current_A.

    Raises:
        BadRequest: nothing matches.
    """
    part = Dictionary(
        commands=tuple(_kept(whole.commands, pattern)),
        evrs=tuple(_kept(whole.evrs, pattern)),
        packets=tuple(_kept(whole.packets, pattern)),
        parameters=tuple(one for one in whole.parameters if _matches(one.name, pattern)),
    )
    if not any((part.commands, part.evrs, part.packets, part.parameters)):
        raise BadRequest(f"dictionary: nothing is called {pattern!r}; {_hint(whole, pattern)}")
    return part


def _kept(entries: Iterable[E], pattern: str) -> Iterator[E]:
    for entry in entries:
        names = (entry.name, entry.scenario_name) if isinstance(entry, CommandEntry) else (entry.name,)
        if any(_matches(name, pattern) for name in names):
            yield entry
            continue
        told = tuple(one for one in entry.fields if _is_meant(entry, one.name, pattern))
        if told:
            yield replace(entry, fields=told)


def _is_meant(entry: Entry, field: str, pattern: str) -> bool:
    return _matches(field, pattern) or is_channel_meant(entry.name.lower(), field.lower(), pattern.lower())


def _matches(name: str, pattern: str) -> bool:
    return fnmatchcase(name.lower(), pattern.lower())


def _hint(whole: Dictionary, pattern: str) -> str:
    """What was probably meant, and how to find it; all names would be a page."""
    entries: list[Entry] = [*whole.commands, *whole.evrs, *whole.packets]
    names = [entry.name for entry in entries] + [one.name for one in whole.parameters]
    names += [channel_name(packet.name, one.name) for packet in whole.packets for one in packet.fields]
    meant, _, _ = did_you_mean(pattern, names).rpartition("there are ")
    return (
        f"{meant}`marsarm dictionary` lists all there is, "
        "and a pattern is written as '*tilt*', where * stands for any letters"
    )
