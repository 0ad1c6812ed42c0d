"""One cycle of the closed loop, as it happened."""

from dataclasses import dataclass

from fsw.dictionary.commands import Command
from fsw.messages import Outputs, Sensors
from sim.truth import Truth


@dataclass(frozen=True, slots=True, eq=False)
class CycleRecord:
    """What went in and what came out in one cycle; the tick is an integer at the cycle rate."""

    tick: int
    sensors: Sensors
    commands: tuple[Command, ...]
    outputs: Outputs
    truth: Truth | None
    """None when the truth was not asked for: it costs time."""
