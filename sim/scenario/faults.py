"""The faults of the hardware that a scenario may inject."""

from typing import Final, get_args

from sim.effects.environment import PowerLoss
from sim.effects.faults import Fault, SensorFault

FAULTS: Final[tuple[type[Fault], ...]] = get_args(Fault)
"""Each is a frozen dataclass with a time `at_s`; that and its fields are what a file says of it."""


def stops(fault: Fault) -> bool:
    """Whether no command that moves can come to its end with this fault."""
    match fault:
        case PowerLoss() | SensorFault(kind="nan"):
            return True
        case _:
            return False
