"""True states of the plant in a scenario, cycle by cycle, for its checks."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import CommandRefused, Evr
from fsw.kinematics.transforms import Array
from sim.contact import tool_forces
from sim.loop import ClosedLoop
from sim.record import CycleRecord
from sim.sequence import Outcome


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """Plant at the end of a cycle, by tool; vectors in RMECH axes."""

    command: int
    """Number of the present command, from 1."""
    p_RoTo_R_m: Mapping[str, Array]
    """Position of each tool, shape (3,)."""
    R_RT: Mapping[str, Array]
    """Rotation of each tool, shape (3, 3)."""
    force_R_N: Mapping[str, Array]
    """Contact force on each tool, shape (3,)."""
    closed: Mapping[str, NDArray[np.bool_]]
    """Switches of each tool that are closed, as this cycle read them."""
    pads_R_m: Mapping[str, Array]
    """Positions of the switches of each tool, shape (n, 3)."""
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
    plant, truth, closed = loop.plant, loop.truth(), record.sensors.switch_closed
    pads_R_m, switches = plant.pads_R_m(), loop.config.protection.tool_switches
    return Snapshot(
        command=command,
        p_RoTo_R_m=dict(zip(plant.tools, truth.p_RoTo_R_m, strict=True)),
        R_RT=dict(zip(plant.tools, truth.R_RT, strict=True)),
        force_R_N=dict(zip(plant.tools, tool_forces(plant), strict=True)),
        closed={tool: closed[list(found)] for tool, found in switches.items()},
        pads_R_m={tool: pads_R_m[list(found)] for tool, found in switches.items()},
        vibrates=record.outputs.drive.vibrate,
    )


def is_touching(snapshot: Snapshot, tool: str) -> bool:
    """Return whether a contact switch of a tool is closed."""
    return bool(snapshot.closed[tool].any())
