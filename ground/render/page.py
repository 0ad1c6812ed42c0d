"""Pages of tables and pictures, each a single self-contained HTML file."""

import base64
import html
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from ground.common.files import atomic_write

STYLE: Final = (
    "body{font:15px/1.5 sans-serif;max-width:62em;margin:2em auto;padding:0 1em;color:#222}"
    "table{border-collapse:collapse;margin:1em 0}td,th{padding:.25em .8em;border-bottom:1px solid #ccc;"
    "text-align:right}td:first-child,th:first-child{text-align:left}img{max-width:100%}"
)


def save_page(title: str, parts: list[str], path: Path) -> None:
    """Write a page.

    Args:
        title: Plain text.
        parts: Parts in HTML, as the other functions here make them.
        path: The HTML file.

    Raises:
        BadOutput: the file cannot be written.
    """
    head = f"<!doctype html><meta charset='utf-8'><title>{html.escape(title)}</title><style>{STYLE}</style>"
    with atomic_write(path, "report") as file:
        file.write("\n".join([head, f"<h1>{html.escape(title)}</h1>", *parts]).encode())


def paragraph(text: str) -> str:
    """Make a paragraph of plain text."""
    return f"<p>{html.escape(text)}</p>"


def heading(text: str) -> str:
    """Make a heading below the title."""
    return f"<h2>{html.escape(text)}</h2>"


def image(png: bytes, alt: str) -> str:
    """Embed a PNG picture in the page."""
    return f"<img alt='{html.escape(alt)}' src='data:image/png;base64,{base64.b64encode(png).decode()}'>"


def table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    """Make a table of plain text."""
    cells = "".join(f"<th>{html.escape(name)}</th>" for name in head)
    lines = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f"<table><tr>{cells}</tr>{lines}</table>"
