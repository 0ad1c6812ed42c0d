"""Samples of a run for a view: from the records of cycles, or from a log."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Mode
from fsw.kinematics.transforms import Array
from ground.common.errors import BadRequest
from ground.telemetry.read import Log
from sim.record import CycleRecord

SAMPLE_CYCLES: Final = CYCLE_HZ // 4
"""Cycles between samples: at 4 Hz no joint turns by more than 2 degrees between two."""
MOST_SAMPLES: Final = 2000
"""Largest number of samples of a log; with it a page stays small, and a joint turns by a degree or two."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """State of the arm at n times, true and as flight software believes it; joint arrays have shape (5, n)."""

    time_s: Array
    """Time since boot, shape (n,)."""
    mode: NDArray[np.intp]
    """Mode of the arm, shape (n,)."""
    tool: NDArray[np.intp]
    """Tool of the last tool command, the first one before it, shape (n,)."""
    motor_rad: Array
    """Motor angles that flight software measures."""
    believed_rad: Array
    """Output angles that flight software estimates."""
    gravity_R_m_s2: Array
    """Gravity in the rover frame that the rover measures, shape (3, n)."""
    current_A: Array
    true_rad: Array | None
    """True output angles; None if they are not known."""
    force_N: Array | None
    """True contact force, shape (n,); None if it is not known."""

    @classmethod
    def of_records(cls, records: Sequence[CycleRecord]) -> Self:
        """Collect the records of cycles, all with the truth or all without."""
        tool, tools = 0, []
        for record in records:
            tool = tool if record.outputs.tool is None else int(record.outputs.tool.tool)
            tools.append(tool)
        joint = [record.outputs.joint for record in records]
        truth = [record.truth for record in records if record.truth is not None]
        return cls(
            time_s=np.array([record.tick for record in records]) / CYCLE_HZ,
            mode=np.array([int(one.mode) for one in joint]),
            tool=np.array(tools),
            motor_rad=np.array([one.motor_rad for one in joint]).T,
            believed_rad=np.array([one.output_rad for one in joint]).T,
            gravity_R_m_s2=np.array([record.sensors.gravity_R_m_s2 for record in records]).T,
            current_A=np.array([record.sensors.current_A for record in records]).T,
            true_rad=np.array([one.output_rad for one in truth]).T if truth else None,
            force_N=np.array([one.contact_force_N for one in truth]) if truth else None,
        )

    @classmethod
    def of_log(cls, log: Log) -> Self:
        """Select the samples of a log, at most MOST_SAMPLES, at regular times.

        Raises:
            BadRequest: the log has no joints, or no gravity.
        """
        missing = [topic for topic in ("/joint", "/sensors") if topic not in log.packets]
        if missing:
            raise BadRequest(f"log {log.path}: has no {missing[0]}, which a view needs; record it with --log")
        ticks, joint = log.ticks("/joint"), log["/joint"]
        period = max(SAMPLE_CYCLES, -(-int(np.ptp(ticks) + 1) // (MOST_SAMPLES - 1)))
        rows = np.unique(np.searchsorted(ticks, np.arange(ticks[0], ticks[-1] + period, period)).clip(0, len(ticks) - 1))
        at = ticks[rows]
        sensors, truth = log["/sensors"][_rows_at(log, "/sensors", at)], None
        if "/truth" in log.packets:
            truth = log["/truth"][_rows_at(log, "/truth", at)]
        tool = log["/tool"]["tool"][_rows_at(log, "/tool", at)] if "/tool" in log.packets else np.zeros(len(at))
        return cls(
            time_s=at / CYCLE_HZ,
            mode=joint["mode"][rows].astype(np.intp),
            tool=tool.astype(np.intp),
            motor_rad=joint["motor_rad"][rows].T,
            believed_rad=joint["output_rad"][rows].T,
            gravity_R_m_s2=sensors["gravity_R_m_s2"].T,
            current_A=sensors["current_A"].T,
            true_rad=None if truth is None else truth["output_rad"].T,
            force_N=None if truth is None else truth["contact_force_N"],
        )

    def select(self, is_chosen: NDArray[np.bool_]) -> Self:
        """Return the samples where the flags, shape (n,), are set."""
        values = [getattr(self, name) for name in self.__slots__]
        return type(self)(*(None if value is None else value[..., is_chosen] for value in values))

    @property
    def mode_names(self) -> list[str]:
        """Names of the modes in words."""
        return [Mode(number).name.lower().replace("_", " ") for number in self.mode]


def _rows_at(log: Log, topic: str, ticks: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the last message of a topic at each tick, or the first one if there is none before, shape (n,)."""
    return (np.searchsorted(log.ticks(topic), ticks, side="right") - 1).clip(0)
