"""Files that are read whole, and are refused if they are none or too large."""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Final


class BadImport(ValueError):
    """A table or a mapping that cannot be imported; a line of the message for each problem."""

    def __init__(self, problems: Iterable[str]):
        self.problems = tuple(problems)
        super().__init__("\n".join(self.problems))


MAX_TABLE_BYTES: Final = 1 << 32


def read_file(path: Path, most: int) -> bytes:
    """What is in a file.

    Raises:
        BadImport: it cannot be read, is no regular file, or is larger than `most` bytes.
    """
    if os.path.exists(path) and not os.path.isfile(path):  # a pipe, say, which would never end
        raise BadImport([f"{path}: is not a regular file; give the path of one"])
    try:
        size = path.stat().st_size
        if size > most:
            raise BadImport([f"{path}: has {size} bytes, more than {most}; is it the right file?"])
        return path.read_bytes()
    except (OSError, ValueError) as error:
        raise BadImport([f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})"]) from error
