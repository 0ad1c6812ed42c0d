"""Reading of whole files with a limit of size, and the error of an import."""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from simgap.common.errors import BadRequest


class BadImport(BadRequest):
    """Error of a table or a mapping that cannot be imported; the message has one line for each problem."""

    def __init__(self, problems: Iterable[str]):
        self.problems = tuple(problems)
        super().__init__("\n".join(self.problems))


MAX_TABLE_BYTES: Final = 1 << 32


def read_file(path: Path, max_bytes: int) -> bytes:
    """Read a file.

    Raises:
        BadImport: it cannot be read, is not a regular file, or is larger than `max_bytes`.
    """
    if os.path.exists(path) and not os.path.isfile(path):  # reading a pipe might never end
        raise BadImport([f"{path}: is not a regular file; give the path of one"])
    try:
        size = path.stat().st_size
        if size > max_bytes:
            raise BadImport([f"{path}: has {size} bytes, more than {max_bytes}; is it the right file?"])
        return path.read_bytes()
    except (OSError, ValueError) as error:
        raise BadImport([f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})"]) from error
