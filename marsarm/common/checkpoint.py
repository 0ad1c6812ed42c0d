"""File of results, one JSON line each, from which an interrupted run continues.

The first line is the request. An incomplete last line is discarded, and its job is repeated. Results of
another request are refused.
"""

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from simgap.common.errors import BadRequest

REQUEST: Final = "request"
NEW_FILE: Final = "give the path of a new file"


class Checkpoint:
    """Open file of results; a context manager."""

    def __init__(
        self, path: Path, request: Mapping[str, Any], read: Callable[[dict[str, Any]], object] = dict
    ):
        """Open the file, and check what it holds.

        Args:
            path: The file; it is made if it is not there.
            request: The request, comparable after a round trip through JSON.
            read: Parser of one result, which raises KeyError, TypeError or ValueError for anything else.

        Raises:
            BadRequest: The file cannot be read or written, has another format, or belongs to another request.
        """
        self._path = path
        self._request = json.loads(json.dumps(request))
        self.done: list[dict[str, Any]] = []
        """Results that the file held when it was opened."""
        try:
            complete_bytes = self._read(read) if os.path.exists(path) else 0
            self._file = path.open("ab")
            self._file.truncate(complete_bytes)
            if complete_bytes == 0:
                self.add({REQUEST: self._request})
        except OSError as error:
            raise BadRequest(f"results {path}: cannot be written ({error.strerror or error})") from error

    def __enter__(self) -> "Checkpoint":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, result: Mapping[str, Any]) -> None:
        """Write a result, and flush it to the disk."""
        self._file.write(json.dumps(result).encode() + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())

    def _read(self, read: Callable[[dict[str, Any]], object]) -> int:
        """Read the complete lines into `done`, and return their length in bytes."""
        if not os.path.isfile(self._path):
            raise self._refuse("this is not a regular file")
        text = self._path.read_bytes()
        head, *lines = text.splitlines(keepends=True) or [b""]
        begin = f'{{"{REQUEST}"'.encode()
        if not head.startswith(begin) and not begin.startswith(text):
            raise self._refuse("holds something else")
        if not head.endswith(b"\n"):
            return 0
        self._check_request(self._parse(1, head)[REQUEST])
        if lines and not lines[-1].endswith(b"\n"):
            lines.pop()
        for number, line in enumerate(lines, start=2):
            result = self._parse(number, line)
            try:
                read(result)
            except (KeyError, TypeError, ValueError) as error:
                raise self._refuse(f"line {number} is no result") from error
            self.done.append(result)
        return sum(map(len, (head, *lines)))

    def _parse(self, number: int, line: bytes) -> dict[str, Any]:
        try:
            return dict(json.loads(line))
        except ValueError as error:
            raise self._refuse(f"line {number} is not JSON") from error
        except TypeError as error:
            raise self._refuse(f"line {number} is no result") from error

    def _check_request(self, recorded: Any) -> None:
        if recorded == self._request:
            return
        old = recorded if isinstance(recorded, dict) else {}
        names = [name for name in self._request if old.get(name) != self._request[name]]
        changes = ", ".join(f"{name} {old.get(name)} there, {self._request[name]} now" for name in names)
        raise self._refuse(f"of another request ({changes})")

    def _refuse(self, why: str) -> BadRequest:
        return BadRequest(f"results {self._path}: {why}; {NEW_FILE}")
