"""Errors of logs that cannot be written or read; each names the file, the problem and the remedy."""

from pathlib import Path

from simgap.common.errors import UserError


class LogError(UserError):
    """Error of a log; `path` is the file and `why` the reason."""

    def __init__(self, path: Path, why: str) -> None:
        super().__init__(f"log {path}: {why}")
        self.path = path
        self.why = why


class LogNotWritable(LogError):
    """Error of a path where no log can be written; nothing was written."""


class LogNotReadable(LogError):
    """Error of a file that is not a marsarm log, or has a format that this version does not know."""


class SchemaError(Exception):
    """Error of a packet, command or EVR with a value that the format of a log cannot hold."""
