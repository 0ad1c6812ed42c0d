"""The console that reports are printed on."""

from typing import Final

from rich.console import Console
from rich.text import Text

WARNED: Final = "bold"


def plain_console(width: int | None = None) -> Console:
    """One that prints what it is given: titles, paths and messages may hold brackets."""
    return Console(highlight=False, markup=False, width=width)


def cell(text: str, style: str) -> Text:
    """A cell of a table in a style of its own."""
    return Text(text, style=style)
