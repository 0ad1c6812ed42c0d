"""Reports: records of what a result shows, and one function each for JSON, the console and a page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from math import isfinite
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from rich.console import Console
from rich.table import Table

from simgap.common.console import NUMBER, WARNING_STYLE, plain_console
from simgap.common.page import Origin, Requirement, figures, heading, paragraph, save_page, table

WHOLE_WIDTH: Final = 240
"""Columns of a table whose lines are not wrapped, on a narrow terminal and in a pipe."""


@dataclass(frozen=True, slots=True)
class ReportTable:
    """Table of a report."""

    head: Sequence[str]
    """Names of the columns; none for a table without a head."""
    rows: Sequence[Sequence[str]]
    """Cells of each row; the last ones may be left out."""
    title: str = ""
    """Title on the console; on a page, a heading stands before it."""
    is_whole: bool = False
    """True for a table that the console does not wrap."""


@dataclass(frozen=True, slots=True)
class Emphasis:
    """Sentence that stands out on the console."""

    text: str


@dataclass(frozen=True, slots=True)
class Heading:
    """Heading on a page."""

    text: str


class ReportFigure(Protocol):
    """Figure on a page; a program brings its own class, so that no library for plots is needed here."""

    def render(self) -> str:
        """Return the element of HTML."""


@dataclass(frozen=True, slots=True, eq=False)
class ReportPage:
    """Page of a report: requirements with their verdicts first, then its parts."""

    title: str
    requirements: Sequence[Requirement]
    origin: Origin
    parts: Sequence[str | Heading | ReportTable | tuple[ReportFigure, ...]]
    """Sentences, headings, tables, and figures that stand side by side."""


def to_json(value: Any) -> Any:
    """Convert a record to what JSON can hold: records and mappings to objects, arrays to lists.

    A number that is not finite becomes null, a member of an enumeration its value or its name.
    """
    match value:
        case Enum():
            return value.value if isinstance(value.value, str) else value.name.lower()
        case bool() | int() | str() | None:
            return value
        case float():
            return float(value) if isfinite(value) else None
        case np.ndarray() | np.generic():
            return to_json(value.tolist())
        case Mapping():
            return {str(name): to_json(item) for name, item in value.items()}
        case Path():
            return str(value)
    if is_dataclass(value):
        return {field.name: to_json(getattr(value, field.name)) for field in fields(value)}
    return [to_json(item) for item in value]


def print_parts(parts: Sequence[str | Emphasis | ReportTable]) -> None:
    """Print sentences and tables of a report; on a terminal, sentences break between words."""
    console = plain_console()
    for part in parts:
        if isinstance(part, str | Emphasis):
            text, style = (part, None) if isinstance(part, str) else (part.text, WARNING_STYLE)
            # a path is never broken, and a program reads a sentence as one line
            console.print(text, style=style, soft_wrap=not console.is_terminal, overflow="ignore", crop=False)
        elif part.is_whole:
            console.print(part.title)
            plain_console(max(Console().width, WHOLE_WIDTH)).print(_console_table(part, ""))
        else:
            console.print(_console_table(part, part.title), crop=False)


def _console_table(part: ReportTable, title: str) -> Table:
    """Make a table for the console; columns of numbers are aligned right and not wrapped."""
    made = Table(title=title or None, title_justify="left", show_header=bool(part.head))
    for k in range(max(map(len, (part.head, *part.rows)))):
        cells = [row[k] for row in part.rows if k < len(row) and row[k]]
        is_number = k > 0 and all(NUMBER.fullmatch(cell) for cell in cells)
        made.add_column(
            part.head[k] if part.head else "",
            justify="right" if is_number else "left",
            min_width=max(map(len, cells), default=0) if is_number else None,
            no_wrap=part.is_whole,
            overflow="fold",
        )
    for row in part.rows:
        made.add_row(*row)
    return made


def file_lines(files: Mapping[str, Path | str | None]) -> list[str]:
    """List files that were written, or reasons why they are missing; leave out those that are None."""
    return [f"{name:<9} {path}" for name, path in files.items() if path is not None]


def save_report_page(page: ReportPage, path: Path) -> None:
    """Write the page of a report; BadOutput if the file cannot be written."""
    save_page(page.title, "", page.requirements, page.origin, [_html(part) for part in page.parts], path)


def _html(part: str | Heading | ReportTable | tuple[ReportFigure, ...]) -> str:
    match part:
        case str():
            return paragraph(part)
        case Heading():
            return heading(part.text)
        case ReportTable():
            width = max(map(len, (part.head, *part.rows)))
            return table(_padded(part.head, width), [_padded(row, width) for row in part.rows])
    return figures(*(one.render() for one in part))


def _padded(cells: Sequence[str], width: int) -> list[str]:
    return [*cells, *[""] * (width - len(cells))]
