"""Files that are read whole, and are refused if they are none or too large."""

import os
from pathlib import Path
from typing import Final

from ground.telemetry.imports.errors import BadImport

MOST_TABLE_BYTES: Final = 1 << 32


def file_bytes(path: Path, most: int) -> bytes:
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
