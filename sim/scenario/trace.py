"""True states of the plant that the checks of a scenario need."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import Evr
from fsw.kinematics.transforms import Array
from sim.clearance import tool_forces
from sim.loop import ClosedLoop
from sim.record import CycleRecord
from sim.scenario.data import Check
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


@dataclass(slots=True)
class Trace:
    """Record of what the checks need of the cycles so far; its size does not depend on their number."""

    ends: dict[int, Snapshot] = field(default_factory=dict)
    """Last snapshot of each command that began."""
    peaks: dict[tuple[Check, str], float] = field(default_factory=dict)
    """Largest value of what a check measures in more than one cycle, by its name."""
    touched_R_m: dict[tuple[Check, int], Array] = field(default_factory=dict)
    """Position of each switch when a check first found it closed, shape (3,)."""


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
