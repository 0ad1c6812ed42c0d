"""What can be wrong with a log: each error says which file, what, and what would be right."""

from pathlib import Path


class LogError(Exception):
    """A log cannot be written or read as asked; `path` and `why` say which and why."""

    def __init__(self, path: Path, why: str) -> None:
        super().__init__(f"log {path}: {why}")
        self.path = path
        self.why = why


class LogNotWritable(LogError):  # says what is so
    """A log cannot be written at this path; nothing was written."""


class LogNotReadable(LogError):  # says what is so
    """This file is not a log of ours, or of a format that this reader does not know."""


class LogCorrupt(LogError):  # says what is so
    """The bytes of a log are not those that were written; `offset` is where in the file it shows."""

    def __init__(self, path: Path, why: str, offset: int) -> None:
        advice = (
            "the file was changed after it was written, and `marsarm log recover` saves what is undamaged"
        )
        super().__init__(path, f"{why} (byte {offset}); {advice}")
        self.offset = offset


class SchemaError(Exception):
    """A packet, command or EVR holds something that a log cannot."""
