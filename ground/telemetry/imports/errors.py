"""What can be wrong with a table or its mapping: each sentence says where, what, and what would be right."""

from collections.abc import Iterable


class BadImport(ValueError):
    """A table or a mapping that cannot be imported; a line of the message for each problem."""

    def __init__(self, problems: Iterable[str]):
        self.problems = tuple(problems)
        super().__init__("\n".join(self.problems))
