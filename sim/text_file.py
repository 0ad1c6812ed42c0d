"""Reading of small text files, with one sentence for each reason why one cannot be read."""

import os
import sys
import tomllib
from pathlib import Path
from typing import Any, Final

MAX_BYTES: Final = 1_000_000
"""Largest size of a text file, seventy times that of all flight parameters."""


NOT_UTF8: Final = "is not text in UTF-8; save it as UTF-8"


class UnreadableText(ValueError):
    """File that is not readable as text; the message says why and what would be right, without its name."""


def read_text(path: Path) -> str:
    """Read a text file in UTF-8, with or without a byte order mark.

    Raises:
        UnreadableText: it cannot be read, is no regular file, is too large, or is not text in UTF-8.
    """
    if os.path.exists(path) and not os.path.isfile(path):  # reading a pipe blocks, a device has no end
        raise UnreadableText("is not a regular file; give the path of a text file")
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise UnreadableText(f"has {size} bytes, more than {MAX_BYTES}; is it the right file?")
        data = path.read_bytes()
    except OSError as error:
        raise UnreadableText(f"cannot be read ({error.strerror or error})") from error
    except UnreadableText:
        raise
    except ValueError as error:  # a null byte in the name
        raise UnreadableText(f"cannot be read ({error})") from error
    return decode_text(data)


def load_toml(text: str) -> dict[str, Any]:
    """Parse a text as TOML.

    Raises:
        ValueError: it is no TOML, or holds what Python cannot print; the message says why.
    """
    try:
        table = tomllib.loads(text)
        repr(table)  # a hexadecimal number is read with any number of digits
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError as error:
        raise ValueError("lists or tables are nested too deeply") from error
    except ValueError as error:
        raise ValueError(f"a whole number has more than {sys.get_int_max_str_digits()} digits") from error
    return table


def decode_text(data: bytes) -> str:
    """Decode a text in UTF-8.

    Raises:
        UnreadableText: it is something else.
    """
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UnreadableText(NOT_UTF8) from error
