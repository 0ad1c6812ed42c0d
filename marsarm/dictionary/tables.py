"""Output of the dictionary: tables for people, a JSON document, and Markdown."""

import re
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from typing import Any, Final

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from marsarm.dictionary.entries import (
    Definition,
    Dictionary,
    EvrDefinition,
    FieldDefinition,
    PacketDefinition,
)

COLUMNS: Final = ("name", "type", "unit", "limits", "default", "text")
FIELD_PATTERN: Final = re.compile(r"\{e\.(\w+)[^}]*\}")
"""Placeholder in the message of an EVR: name of the field and its format."""


def dictionary_json(dictionary: Dictionary) -> dict[str, Any]:
    """Return the dictionary as a JSON document."""
    return asdict(dictionary)


def dictionary_tables(dictionary: Dictionary) -> None:
    """Print the dictionary by section: heading, sentence and fields of each entry."""
    console = Console(highlight=False)
    for title, entries in _sections(dictionary):
        console.rule(title, align="left")
        for entry in entries:
            console.print(f"\n[bold]{escape(_heading(entry))}[/bold]  {escape(_sentence(entry))}")
            if entry.fields:
                console.print(_table(entry.fields))
    if dictionary.parameters:
        console.rule("parameters", align="left")
        console.print(_table(dictionary.parameters))


def dictionary_markdown(dictionary: Dictionary) -> str:
    """Return the dictionary as a Markdown page."""
    return "\n".join(_markdown(dictionary)) + "\n"


def _markdown(dictionary: Dictionary) -> Iterator[str]:
    yield "# Dictionary"
    for title, entries in _sections(dictionary):
        yield f"\n## {title.capitalize()}"
        for entry in entries:
            yield f"\n### {_heading(entry)}\n{_sentence(entry)}"
            if entry.fields:
                yield from _markdown_table(entry.fields)
    if dictionary.parameters:
        yield "\n## Parameters"
        yield from _markdown_table(dictionary.parameters)


def _markdown_table(fields: Iterable[FieldDefinition]) -> Iterator[str]:
    yield f"\n| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}"
    for one in fields:
        yield "| " + " | ".join(cell.replace("|", "\\|").replace("*", "\\*") for cell in _cells(one)) + " |"


def _sections(dictionary: Dictionary) -> Iterator[tuple[str, tuple[Definition, ...]]]:
    sections: dict[str, tuple[Definition, ...]] = {
        "commands": dictionary.commands,
        "event reports": dictionary.evrs,
        "channels": dictionary.packets,
    }
    yield from ((title, entries) for title, entries in sections.items() if entries)


def _heading(entry: Definition) -> str:
    match entry:
        case EvrDefinition():
            return f"{entry.name} ({entry.severity})"
        case PacketDefinition(is_truth=True):
            return f"{entry.name} (truth: the plant's own; flight software never sees it)"
        case _:
            return entry.name


def _sentence(entry: Definition) -> str:
    text = " ".join(entry.text.split())
    if not isinstance(entry, EvrDefinition):
        return text
    response = "" if entry.response is None else f" Response: {entry.response}."
    message = FIELD_PATTERN.sub(r"{\1}", entry.message)
    return f'{text} "{message}"{response}'


def _table(fields: Iterable[FieldDefinition]) -> Table:
    table = Table(show_edge=False, pad_edge=False)
    rows = [_cells(one) for one in fields]
    used = [k for k in range(len(COLUMNS)) if any(row[k] for row in rows)]
    for k in used:
        table.add_column(COLUMNS[k], overflow="fold")
    for row in rows:
        table.add_row(*(escape(row[k]) for k in used))
    return table


def _cells(one: FieldDefinition) -> tuple[str, ...]:
    limits = "" if one.low is None or one.high is None else f"{one.low:g} .. {one.high:g}"
    return one.name, one.type, one.unit or "", limits, _default_text(one.default), " ".join(one.text.split())


def _default_text(default: Any) -> str:
    """Format a default; "..." if it is too long for a table."""
    match default:
        case None:
            return ""
        case bool():
            return "yes" if default else "no"
        case float():
            return f"{default:.6g}"
        case list() if len(default) > 6 or any(isinstance(item, list) for item in default):
            return "..."
        case list():
            return " ".join(_default_text(item) for item in default)
        case _:
            return str(default)
