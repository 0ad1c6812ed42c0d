"""Descriptions of tables that cannot be read."""

import re
from typing import Final

from simgap.common.toml import NOT_UTF8

NO_UTF8: Final = ("utf-8", "utf8")
WRONG_WIDTH: Final = re.compile(
    r"(?:Row #(?P<row>[0-9]+): )?Expected (?P<right>[0-9]+) columns, got (?P<n>[0-9]+)"
)
"""Error of pyarrow about a row with another number of columns than the first."""


def describe_bad_table(error: Exception, kind: str) -> str:
    """Describe why a table cannot be read, in place of the words and bytes that a library gives.

    Args:
        error: Error of the library.
        kind: Expected format.
    """
    text = str(error)
    if "pickle" in text:
        return "holds Python objects; only arrays of numbers are read"
    if isinstance(error, UnicodeDecodeError) or any(name in text.lower() for name in NO_UTF8):
        return NOT_UTF8
    width = WRONG_WIDTH.search(text)
    if width is not None:
        row = f"row {width['row']}" if width["row"] else "a row"
        return f"cannot be read as {kind}: {row} has {width['n']} columns, the first has {width['right']}"
    return f"cannot be read as {kind}; it is damaged, cut short or of another format"
