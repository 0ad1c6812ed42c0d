"""True states of the plant in a scenario, cycle by cycle, for its checks."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.enums import TOOL_SWITCHES, Mode, Switch, Tool
from fsw.dictionary.evrs import CommandRefused, Evr
from fsw.kinematics.transforms import Array
from sim.contact import tool_forces
from sim.loop import ClosedLoop
from sim.record import CycleRecord
from sim.sequence import Outcome


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """Plant at the end of a cycle; tools in the order of Tool, vectors in RMECH axes."""

    command: int
    """Number of the present command, from 1."""
    p_RoTo_R_m: Array
    """Positions, shape (5, 3)."""
    R_RT: Array
    """Rotations, shape (5, 3, 3)."""
    force_R_N: Array
    """Contact forces on each tool, shape (5, 3)."""
    closed: NDArray[np.bool_]
    """Closed switches as this cycle read them, in the order of Switch."""
    pads_R_m: Array
    """Positions of the contact switches, shape (10, 3)."""
    vibrates: bool


@dataclass(frozen=True, slots=True, eq=False)
class Ending:
    """State of plant and flight software at the end of a scenario."""

    outcome: Outcome
    mode: Mode
    """Mode of flight software."""
    output_rad: Array
    """True output angles, shape (5,)."""
    braked: bool
    """True if every brake is on and no motor has power."""
    refuses: bool
    """True if a command to move after the end was refused."""
    evrs: tuple[tuple[float, Evr], ...]
    """Time [s] and event."""
    pending_faults: int = 0
    """Number of faults of the scenario that have not begun."""

    @property
    def refusal(self) -> CommandRefused | None:
        """Return the refusal that ended the sequence, or None."""
        found = [evr for _, evr in self.evrs if isinstance(evr, CommandRefused)]
        return found[0] if found and self.outcome is Outcome.REFUSED else None


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """True states of a whole scenario."""

    snapshots: tuple[Snapshot, ...]
    ending: Ending

    def during(self, command: int) -> tuple[Snapshot, ...]:
        """Return the cycles of a command; none if it did not begin."""
        return tuple(snapshot for snapshot in self.snapshots if snapshot.command == command)

    def since(self, command: int) -> tuple[Snapshot, ...]:
        """Return the cycles from the start of a command to the end of the scenario."""
        return tuple(snapshot for snapshot in self.snapshots if snapshot.command >= command)

    def at_end_of(self, command: int) -> Snapshot | None:
        """Return the last cycle of a command, or None if it did not begin."""
        found = self.during(command)
        return found[-1] if found else None


def take_snapshot(loop: ClosedLoop, record: CycleRecord, command: int) -> Snapshot:
    """Record the state of the plant after a cycle."""
    plant, truth = loop.plant, loop.truth()
    return Snapshot(
        command=command,
        p_RoTo_R_m=truth.p_RoTo_R_m,
        R_RT=truth.R_RT,
        force_R_N=tool_forces(plant),
        closed=record.sensors.switch_closed,
        pads_R_m=plant.pads_R_m(),
        vibrates=record.outputs.drive.vibrate,
    )


def is_touching(snapshot: Snapshot, tool: Tool) -> bool:
    """Return whether a contact switch of a tool is closed."""
    closed: NDArray[np.bool_] = snapshot.closed[[Switch(switch) for switch in TOOL_SWITCHES[tool]]]
    return bool(closed.any())
