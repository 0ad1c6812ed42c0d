"""Files that are written whole or not at all."""

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO


class BadOutput(ValueError):
    """A file cannot be written where it was asked for; what was there before is still there."""


def check_output(path: str | os.PathLike[str], suffixes: tuple[str, ...], what: str) -> Path:
    """Give the path back if a file can be written there; `what` is the option that named it.

    Raises:
        BadOutput: wrong suffix, no such folder, a name that cannot be, no file, or no right to write.
    """
    file = Path(path)
    if file.suffix.lower() not in suffixes:
        raise BadOutput(f"{what} {file}: its name must end in {' or '.join(suffixes)}")
    check_new_path(file, what)
    if os.path.isdir(file):
        raise BadOutput(f"{what} {file}: this is a folder; name a file in it")
    exists = os.path.exists(file)
    if exists and not os.path.isfile(file):
        raise BadOutput(f"{what} {file}: this is not a regular file; give the path of a new file")
    if not os.access(file if exists else file.parent, os.W_OK):
        raise BadOutput(f"{what} {file}: no right to write there")
    return file


def check_new_path(place: Path, what: str) -> None:
    """BadOutput if there is no folder to make this in, or it has a bad name, or is a link to nothing."""
    if not os.path.isdir(place.parent):  # unlike Path.is_dir, False for any bad name
        raise BadOutput(f"{what} {place}: there is no folder {place.parent}")
    try:
        place.lstat()
    except FileNotFoundError:
        pass  # it is new
    except OSError as error:
        raise BadOutput(f"{what} {place}: cannot be written ({error.strerror})") from error
    if os.path.islink(place) and not os.path.exists(place):
        raise BadOutput(f"{what} {place}: this is a link to {os.readlink(place)}, which is not there")


@contextmanager
def atomic_write(path: Path, what: str) -> Iterator[BinaryIO]:
    """Open a temporary file beside `path` that takes its place when the block ends well, and else goes.

    Raises:
        BadOutput: the file cannot be written, at the start or on the way.
    """
    place = Path(os.path.realpath(path))  # a link stays a link
    try:
        with atomic_path(place) as part, part.open("xb") as file:
            yield file
    except OSError as error:
        raise BadOutput(f"{what} {path}: cannot be written ({error.strerror or error})") from error


@contextmanager
def atomic_path(place: Path) -> Iterator[Path]:
    """The path of a file or folder to be made: it takes this place when the block ends well, and else goes.

    A folder takes the place of none but an empty one.

    Raises:
        OSError: it cannot take the place, in which all is as it was.
    """
    part = place.with_name(f".marsarm-{secrets.token_hex(8)}.part")
    try:
        yield part
        os.replace(part, place)
    except BaseException:
        if part.is_dir():
            shutil.rmtree(part, ignore_errors=True)
        else:
            with suppress(OSError):
                part.unlink()
        raise
