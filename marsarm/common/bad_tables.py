"""Tables as files: reading with a limit of size, and descriptions of those that cannot be read."""

import os
import re
from pathlib import Path
from typing import Final

from sim.text_file import NOT_UTF8
from simgap.common.errors import BadRequest

MAX_TABLE_BYTES: Final = 1 << 32

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


def read_table_file(path: Path) -> bytes:
    """Read the content of a file.

    Raises:
        BadRequest: it cannot be read, is not a regular file, or is larger than MAX_TABLE_BYTES.
    """
    if os.path.exists(path) and not os.path.isfile(path):  # reading a pipe might never end
        raise BadRequest(f"{path}: is not a regular file; give the path of one")
    try:
        size = path.stat().st_size
        if size > MAX_TABLE_BYTES:
            raise BadRequest(f"{path}: has {size} bytes, more than {MAX_TABLE_BYTES}; is it the right file?")
        return path.read_bytes()
    except (OSError, ValueError) as error:
        raise BadRequest(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from error
