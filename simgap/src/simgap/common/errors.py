"""Errors that a verb reports in one sentence; any other exception is a bug."""

from typing import ClassVar


class UserError(Exception):
    """Error with a message for the user, who can correct the cause."""

    exit_status: ClassVar[int] = 2
    """Exit status of the verb."""


def describe_problems(error: Exception) -> str:
    """Return the message of an error; a message with a line for each problem opens with a sentence."""
    first, *more = str(error).splitlines() or [type(error).__name__]
    if not more or first.endswith(":"):
        return str(error)
    return f"{len(more) + 1} things are wrong, one in each line:\n{error}"


class BadRequest(UserError, ValueError):
    """Error for a request that cannot be carried out; nothing moved and nothing was written."""


class BadOutput(BadRequest):
    """Error for a file that cannot be written at its path; an existing file is unchanged."""


class RobotError(UserError):
    """A robot file, a log or a request is wrong; the text is one sentence for the user."""
