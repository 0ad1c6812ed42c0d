"""How a log comes to be at its path: with its beginning, or not at all."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from fcntl import F_DUPFD_CLOEXEC, fcntl
from io import FileIO
from pathlib import Path

from mcap.records import Metadata

from ground.common.files import beside
from ground.telemetry.catalogue import Announced, header_text, records_of
from ground.telemetry.errors import LogNotWritable
from ground.telemetry.format import CHANNELS_KEY, FORMAT, FORMAT_RECORD, HEADER_RECORD, header_crc32
from ground.telemetry.mcap_file import McapFile, Written


@contextmanager
def begun(
    path: Path, header: Mapping[str, str], channels: tuple[Announced, ...]
) -> Iterator[tuple[FileIO, Written]]:
    """A log that holds what comes before any message; open for the block.

    When the block ends well, it takes the place of what was at this path, and else it goes.

    Raises:
        LogNotWritable: there can be no file, or there is no room; what was there is still there.
    """
    place = _place(path)
    try:
        with beside(place) as part, FileIO(part, "xb", opener=_opened) as file:
            yield file, _beginning(file, header, channels)
    except OSError as error:
        why = f"cannot be written ({error.strerror}); give a path with room that you may write"
        raise LogNotWritable(path, why) from error


def _opened(path: str, flags: int) -> int:
    """A file, not in the place of a standard stream that is closed: a new process takes those for its own."""
    found = os.open(path, flags, 0o666)
    try:
        return fcntl(found, F_DUPFD_CLOEXEC, 3)
    finally:
        os.close(found)


def _place(path: Path) -> Path:
    """Where the file goes, links followed."""
    try:
        if path.is_dir():
            raise LogNotWritable(path, "is a directory; give the path of a file, such as run.mcap in it")
        exists = path.exists()
        if exists and not path.is_file():
            raise LogNotWritable(path, "is not a regular file; give the path of a new file")
        if not path.parent.is_dir():
            raise LogNotWritable(path, f"directory {path.parent} does not exist; make it, or give another")
        if exists and not os.access(path, os.W_OK):
            raise LogNotWritable(path, "is there and you may not write it; give the path of a new file")
        return Path(os.path.realpath(path))
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise LogNotWritable(path, f"cannot be written ({why}); give a path that you may write") from error


def _beginning(file: FileIO, header: Mapping[str, str], channels: tuple[Announced, ...]) -> Written:
    log = McapFile(file)
    header = {**header, CHANNELS_KEY: header_text(channels)}
    about = {"version": FORMAT, "header_crc32": header_crc32(header)}
    log.begin([Metadata(FORMAT_RECORD, about), Metadata(HEADER_RECORD, header)], *records_of(channels))
    return log.written
