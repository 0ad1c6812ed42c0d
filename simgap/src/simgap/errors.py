"""Errors of the user: one sentence that says what, where, and what would be right."""


class RobotError(Exception):
    """A robot file, a log or a request is wrong; the text is one sentence for the user."""
