"""Errors that a verb reports in one sentence; any other exception is a bug."""

from typing import ClassVar


class UserError(Exception):
    """Error with a message for the user, who can correct the cause."""

    exit_status: ClassVar[int] = 2
    """Exit status of the verb."""


class BadRequest(UserError, ValueError):
    """Error for a request that cannot be carried out; nothing moved and nothing was written."""


class BadOutput(BadRequest):
    """Error for a file that cannot be written at its path; an existing file is unchanged."""
