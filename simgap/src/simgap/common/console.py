"""Text for the terminal: consoles and plurals."""

import re
from typing import Final

from rich.console import Console

NUMBER: Final = re.compile(r"[-+±]? ?\d.{0,23}|never|-")
"""Cell that is a number with its unit or an interval; a column of these is aligned right and not wrapped."""


def pluralize(count: int, one: str) -> str:
    """Format a count with its noun: 1 channel, 2 channels."""
    return f"{count} {one}" if count == 1 else f"{count} {one}s"


WARNING_STYLE: Final = "bold"


def plain_console(width: int | None = None) -> Console:
    """Make a console that interprets no markup: titles, paths and messages may contain brackets, colons."""
    return Console(highlight=False, markup=False, emoji=False, width=width)
