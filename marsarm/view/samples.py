"""Samples of a run for a view: from the records of cycles, or from a log."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Mode
from fsw.kinematics.transforms import Array
from marsarm.telemetry.read import Log
from sim.record import CycleRecord
from simgap.common.errors import BadRequest

SAMPLE_CYCLES: Final = CYCLE_HZ // 4
"""Cycles between samples: at 4 Hz no joint turns by more than 2 degrees between two."""
MOST_SAMPLES: Final = 2000
"""Largest number of samples of a log; in half an hour, a joint turns by 5 degrees at most between two."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """State of the arm at n times, true and as flight software believes it; joint arrays are (5, n)."""

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
    def of_records(
        cls, time_s: Sequence[float], tools: Sequence[int], records: Sequence[CycleRecord]
    ) -> Self:
        """Collect the records of cycles, all with the truth or all without, with their times and tools."""
        joint = [record.outputs.joint for record in records]
        truth = [record.truth for record in records if record.truth is not None]
        return cls(
            time_s=np.array(time_s),
            mode=np.array([int(one.mode) for one in joint]),
            tool=np.array(tools, np.intp),
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
        rows = np.unique(
            np.searchsorted(ticks, np.arange(ticks[0], ticks[-1] + period, period)).clip(0, len(ticks) - 1)
        )
        at = ticks[rows]
        sensors, truth = log["/sensors"][_rows_at(log, "/sensors", at)], None
        if "/truth" in log.packets:
            truth = log["/truth"][_rows_at(log, "/truth", at)]
        tool = (
            log["/tool"]["tool"][_rows_at(log, "/tool", at)] if "/tool" in log.packets else np.zeros(len(at))
        )
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

    def select_known(self) -> Self:
        """Return the samples in which flight software has finite angles, and the rover finite gravity."""
        is_known = np.isfinite(np.vstack([self.believed_rad, self.motor_rad, self.gravity_R_m_s2])).all(
            axis=0
        )
        values: dict[str, Any] = {field.name: getattr(self, field.name) for field in fields(self)}
        known: dict[str, Any] = {n: v if v is None else v[..., is_known] for n, v in values.items()}
        return replace(self, **known)

    def without_truth(self) -> Self:
        """Return the samples without what only a simulator knows."""
        return replace(self, true_rad=None, force_N=None)

    @property
    def mode_names(self) -> list[str]:
        """Names of the modes in words."""
        return [Mode(number).name.lower().replace("_", " ") for number in self.mode]


def _rows_at(log: Log, topic: str, ticks: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the row of the last message of a topic at each tick, or of the first one, shape (n,)."""
    return (np.searchsorted(log.ticks(topic), ticks, side="right") - 1).clip(0)
