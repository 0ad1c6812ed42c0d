"""Checks of output paths, files that are written completely or not at all, and digests."""

import fcntl
import hashlib
import json
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import combinations
from pathlib import Path
from typing import Any, BinaryIO, Final

from simgap.common.errors import BadOutput, BadRequest, RobotError
from simgap.common.interruption import defer_interrupts


def check_output(path: str | os.PathLike[str], suffixes: tuple[str, ...], what: str) -> Path:
    """Return the path if a file of such a suffix can be written there; BadOutput, with its option, if not."""
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


def check_new_path(path: Path, what: str) -> None:
    """Check that a file or folder can be made at this path; BadOutput if not."""
    if not os.path.isdir(path.parent):  # unlike Path.is_dir, False for any bad name
        raise BadOutput(f"{what} {path}: there is no folder {path.parent}")
    try:
        path.lstat()
    except FileNotFoundError:
        pass  # it is new
    except OSError as error:
        raise BadOutput(f"{what} {path}: cannot be written ({error.strerror})") from error
    if os.path.islink(path) and not os.path.exists(path):
        raise BadOutput(f"{what} {path}: this is a link to {os.readlink(path)}, which is not there")


def check_distinct_files(files: dict[str, Path | None]) -> None:
    """Refuse two options that name the same file, also through links."""
    given = [(name, path) for name, path in files.items() if path is not None]
    for (one, path), (other, same) in combinations(given, 2):
        if _same_file(path, same):
            raise BadRequest(f"{other} {same}: this is the file of {one} too; give each a file of its own")


def _same_file(one: Path, other: Path) -> bool:
    if os.path.realpath(one) == os.path.realpath(other):
        return True
    return os.path.exists(one) and os.path.exists(other) and os.path.samefile(one, other)


def read_bytes(path: Path, most: int, what: str) -> bytes:
    """Read a file, such as "a table"; RobotError if it has more than these bytes or cannot be read."""
    try:
        if os.path.exists(path) and not os.path.isfile(path):  # reading a pipe blocks, a device has no end
            raise RobotError(f"{path}: is not a regular file; give the path of {what}")
        size = path.stat().st_size
        if size > most:
            raise RobotError(f"{path}: has {size} bytes, more than {most}; is it the right file?")
        return path.read_bytes()
    except OSError as error:
        raise RobotError(f"{path}: cannot be read ({error.strerror or error})") from error
    except ValueError as error:  # a null byte in the name
        raise RobotError(f"{str(path)!r}: is no name of a file; give the path of {what}") from error


FILMS: Final = (".mp4", ".png", ".jpg")
"""Files in the folder of a data set that are large, and that no number comes from."""


def file_sha256(path: Path) -> str:
    """Compute the SHA-256 of a file; of a folder, that of the names and digests of its files but films."""
    if path.is_dir():
        found = [one for one in sorted(path.rglob("*")) if one.is_file() and one.suffix not in FILMS]
        lines = [f"{one.relative_to(path).as_posix()} {file_sha256(one)}\n" for one in found]
        return hashlib.sha256("".join(lines).encode()).hexdigest()
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def digest_files(files: Mapping[str, Iterable[Path]]) -> dict[str, str]:
    """Compute the SHA-256 of files, by kind and path, as the user gave it."""
    return {f"{kind} {path}": file_sha256(path) for kind, paths in files.items() for path in paths}


def cache_folder(program: str, name: str) -> Path:
    """Return a cache folder of a program by the XDG specification; an empty variable counts as unset."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    return base / program / name


def check_unlocked(path: Path | None, what: str) -> None:
    """Refuse by BadOutput a file that another run is writing: its lock ends with that run."""
    if path is None:
        return
    with suppress(OSError), path.open("rb") as file:
        if not lock_file(file.fileno()):
            raise BadOutput(f"{what} {path}: another run is writing it; wait for it, or give another file")


def lock_file(file: int) -> bool:
    """Lock a file until its last descriptor is closed; return False if another process holds the lock.

    A file system without locks locks nothing.
    """
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


@contextmanager
def atomic_write(path: Path, what: str) -> Iterator[BinaryIO]:
    """Open a temporary file that replaces `path` if the block succeeds; BadOutput if it cannot be written."""
    target = Path(os.path.realpath(path))  # a link stays a link
    try:
        with atomic_path(target) as part, part.open("xb") as file:
            yield file
    except OSError as error:
        raise BadOutput(f"{what} {path}: cannot be written ({error.strerror or error})") from error


@contextmanager
def atomic_path(target: Path) -> Iterator[Path]:
    """Give a temporary path for a file or folder that the block makes.

    It replaces `target` when the block succeeds, and is deleted when the block fails. A folder can replace
    only an empty folder. OSError says that it cannot, and that the target is unchanged.
    """
    part = target.with_name(f".write-{os.urandom(8).hex()}.part")
    try:
        yield part
        os.replace(part, target)
    except BaseException:
        with defer_interrupts:
            if part.is_dir():
                shutil.rmtree(part, ignore_errors=True)
            else:
                with suppress(OSError):
                    part.unlink()
        raise


def json_sha256(document: dict[str, Any]) -> str:
    """Compute the SHA-256 of a document, whatever its order and spaces."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()
