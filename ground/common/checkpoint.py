"""Results of long work, one JSON line each as it is done: a run that was killed goes on where it was.

The first line says what was asked. A last line that was torn is done again; results of another request are
refused.
"""

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Final

from ground.common.requests import BadRequest

REQUEST: Final = "request"


class Checkpoint:
    """An open file of results; use as a context.

    Raises:
        BadRequest: the file cannot be read or written, is none of these, or answers another request.
    """

    def __init__(
        self, path: Path, request: Mapping[str, Any], read: Callable[[dict[str, Any]], object] = dict
    ):
        """`read` raises KeyError, TypeError or ValueError for what is no result."""
        self._path = path
        self._read_one = read
        self._request = json.loads(json.dumps(request))
        self.done: list[dict[str, Any]] = []
        """What the file holds already."""
        try:
            self._file = self._opened()
        except OSError as error:
            raise BadRequest(f"results {path}: cannot be written ({error.strerror or error})") from error

    def __enter__(self) -> "Checkpoint":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, result: Mapping[str, Any]) -> None:
        """Write a result, and see it on the disk."""
        self._file.write(json.dumps(result).encode() + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())

    def _opened(self) -> BinaryIO:
        if os.path.exists(self._path) and not os.path.isfile(self._path):
            raise BadRequest(f"results {self._path}: this is not a regular file; give the path of a new file")
        whole = self._read() if os.path.exists(self._path) else 0
        file = self._path.open("ab")
        file.truncate(whole)
        if whole == 0:
            self._file = file
            self.add({REQUEST: self._request})
        return file

    def _read(self) -> int:
        """Take in the lines that are whole; up to where they are, in bytes."""
        text = self._path.read_bytes()
        whole = text.rfind(b"\n") + 1
        lines = [self._line(number, line) for number, line in enumerate(text[:whole].splitlines(), start=1)]
        if not lines:
            if text and not f'{{"{REQUEST}"'.encode().startswith(text[: len(REQUEST) + 3]):
                raise BadRequest(f"results {self._path}: holds something else; give the path of a new file")
            return 0
        if REQUEST not in lines[0]:
            raise BadRequest(f"results {self._path}: holds something else; give the path of a new file")
        self._check(lines[0][REQUEST])
        for number, line in enumerate(lines[1:], start=2):
            self._see(number, line)
        self.done = lines[1:]
        return whole

    def _line(self, number: int, line: bytes) -> dict[str, Any]:
        try:
            found = json.loads(line)
        except ValueError as error:
            raise BadRequest(
                f"results {self._path}: line {number} is not JSON; mend it, or give the path of a new file"
            ) from error
        if not isinstance(found, dict):
            raise BadRequest(f"results {self._path}: line {number} is no result; give the path of a new file")
        return found

    def _see(self, number: int, line: dict[str, Any]) -> None:
        try:
            self._read_one(line)
        except (KeyError, TypeError, ValueError) as error:
            raise BadRequest(
                f"results {self._path}: line {number} is no result; give the path of a new file"
            ) from error

    def _check(self, was: Any) -> None:
        if was == self._request:
            return
        asked = was if isinstance(was, dict) else {}
        names = [name for name in self._request if asked.get(name) != self._request[name]]
        apart = ", ".join(f"{name} {asked.get(name)} there, {self._request[name]} now" for name in names)
        raise BadRequest(
            f"results {self._path}: of another request ({apart}); give that one, or the path of a new file"
        )
