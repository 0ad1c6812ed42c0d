"""File of results, one JSON line each, from which an interrupted run continues.

The first line is the request. An incomplete last line is discarded, and its job is repeated. Results of
another request are refused.
"""

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Final

from simgap.common.errors import BadRequest

REQUEST: Final = "request"


class Checkpoint:
    """Open file of results; a context manager.

    Raises:
        BadRequest: the file cannot be read or written, has another format, or belongs to another request.
    """

    def __init__(
        self, path: Path, request: Mapping[str, Any], read: Callable[[dict[str, Any]], object] = dict
    ):
        """Open the file, and check what it holds.

        Args:
            path: The file; it is made if it is not there.
            request: The request, comparable after a round trip through JSON.
            read: Parser of one result, which raises KeyError, TypeError or ValueError for anything else.
        """
        self._path = path
        self._parse_result = read
        self._request = json.loads(json.dumps(request))
        self.done: list[dict[str, Any]] = []
        """Results that the file held when it was opened."""
        try:
            self._file = self._open()
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

    def _open(self) -> BinaryIO:
        if os.path.exists(self._path) and not os.path.isfile(self._path):
            raise BadRequest(f"results {self._path}: this is not a regular file; give the path of a new file")
        complete_bytes = self._read() if os.path.exists(self._path) else 0
        file = self._path.open("ab")
        file.truncate(complete_bytes)
        if complete_bytes == 0:
            self._file = file
            self.add({REQUEST: self._request})
        return file

    def _read(self) -> int:
        """Read the complete lines into `done`, and return their length in bytes."""
        text = self._path.read_bytes()
        complete_bytes = text.rfind(b"\n") + 1
        complete = text[:complete_bytes].splitlines()
        lines = [self._parse_line(number, line) for number, line in enumerate(complete, start=1)]
        if not lines:
            if text and not f'{{"{REQUEST}"'.encode().startswith(text[: len(REQUEST) + 3]):
                raise BadRequest(f"results {self._path}: holds something else; give the path of a new file")
            return 0
        if REQUEST not in lines[0]:
            raise BadRequest(f"results {self._path}: holds something else; give the path of a new file")
        self._check_request(lines[0][REQUEST])
        for number, line in enumerate(lines[1:], start=2):
            self._check_result(number, line)
        self.done = lines[1:]
        return complete_bytes

    def _parse_line(self, number: int, line: bytes) -> dict[str, Any]:
        try:
            document = json.loads(line)
        except ValueError as error:
            raise BadRequest(
                f"results {self._path}: line {number} is not JSON; mend it, or give the path of a new file"
            ) from error
        if not isinstance(document, dict):
            raise BadRequest(f"results {self._path}: line {number} is no result; give the path of a new file")
        return document

    def _check_result(self, number: int, line: dict[str, Any]) -> None:
        try:
            self._parse_result(line)
        except (KeyError, TypeError, ValueError) as error:
            raise BadRequest(
                f"results {self._path}: line {number} is no result; give the path of a new file"
            ) from error

    def _check_request(self, recorded: Any) -> None:
        if recorded == self._request:
            return
        old = recorded if isinstance(recorded, dict) else {}
        names = [name for name in self._request if old.get(name) != self._request[name]]
        changes = ", ".join(f"{name} {old.get(name)} there, {self._request[name]} now" for name in names)
        raise BadRequest(
            f"results {self._path}: of another request ({changes}); give that one, or the path of a new file"
        )
