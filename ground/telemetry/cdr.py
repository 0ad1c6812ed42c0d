"""ROS 2 messages of any form in CDR, one value after the other."""

import struct
from typing import Final, Self

from ground.telemetry.schema import ENCAPSULATION, aligned

STAMP: Final = struct.Struct("<iI")
"""builtin_interfaces/Time: seconds and nanoseconds."""


def stamp(time_ns: int) -> tuple[int, int]:
    """Seconds and nanoseconds of a time."""
    return divmod(time_ns, 1_000_000_000)


class CdrWriter:
    """A message in the making; values are added in the order of its definition."""

    def __init__(self) -> None:
        self.data = bytearray(ENCAPSULATION)

    def add(self, kinds: str, *values: float) -> Self:
        """Add numbers, each of a kind of struct's: as "d" for float64."""
        for kind, value in zip(kinds, values, strict=True):
            size = struct.calcsize(f"<{kind}")
            self.data = self.data.ljust(aligned(len(self.data), size), b"\0") + struct.pack(f"<{kind}", value)
        return self

    def text(self, text: str) -> Self:
        """Add a string."""
        # What comes from the operating system may hold bytes that are no text: keep them legible.
        content = text.encode(errors="backslashreplace") + b"\0"
        self.add("I", len(content))
        self.data += content
        return self

    def header(self, time_ns: int, frame: str) -> Self:
        """Add a std_msgs/Header."""
        return self.add("iI", *stamp(time_ns)).text(frame)

    def place(self, numbers: int) -> int:
        """Add so many float64 to be filled in later; where they begin."""
        self.add("d" * numbers, *[0.0] * numbers)
        return len(self.data) - 8 * numbers
