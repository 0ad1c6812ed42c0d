"""Figures of a check: command, position and nominal simulation of each joint in one motion."""

from typing import Any, Final

import numpy as np

from simgap.arrays import Array, Flags, Integers
from simgap.audit.records import hold, runs
from simgap.command.execution import CheckReport
from simgap.common import svg
from simgap.logs import JointLog, Motion

MAX_POINTS: Final = 600
"""Points of a line: more than one in a pixel of a phone, fewer than make a page heavy."""
HEIGHT_INCH: Final = 2.5


def motion_figures(report: CheckReport, number: int) -> list[str]:
    """Draw the joints of a motion, one figure each."""
    return [joint_figure(report, number, joint.name) for joint in report.robot.joints]


def joint_figure(report: CheckReport, number: int, joint: str) -> str:
    """Draw command, position and nominal simulation of one joint; a shade marks what is left out."""
    motion, nominal = report.logs.motions[number], report.nominal[number]
    usable = report.audit.is_usable(motion.name, joint)
    alt = f"{motion.name}: {joint}, command, position and nominal simulation"

    def draw(figure: Any) -> None:
        axes = figure.subplots()
        _draw(axes, motion, joint, nominal.position[joint], usable)

    return svg.render_svg(alt, HEIGHT_INCH, draw)


def _draw(axes: Any, motion: Motion, joint: str, nominal: Array, usable: Flags) -> None:
    log: JointLog = motion.joints[joint]
    time_s, value = log.position.time_s, log.position.value
    for k, (begin, end) in enumerate(runs(~usable)):
        label = "left out" if k == 0 else None
        last = min(end, time_s.size - 1)
        axes.axvspan(time_s[begin], time_s[last], color=svg.SHADE, linewidth=0, label=label)
    if log.command is not None:
        at = _extremes(hold(log.command, time_s))
        axes.plot(time_s[at], hold(log.command, time_s)[at], color=svg.AMBER, linewidth=1.0, label="command")
    at = _extremes(nominal)
    axes.plot(time_s[at], nominal[at], color=svg.VIOLET, linewidth=1.0, linestyle="--", label="nominal")
    at = _extremes(value)
    axes.plot(time_s[at], value[at], color=svg.BLUE, linewidth=1.2, label="position")
    axes.set(title=joint, xlabel="time [s]", ylabel="angle [rad]")
    axes.margins(x=0.0)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.28), ncols=4)


def _extremes(value: Array) -> Integers:
    """Return indices of the smallest and the largest value in each of many equal parts, in order."""
    if value.size <= MAX_POINTS:
        return np.arange(value.size)
    parts = np.array_split(np.nan_to_num(value), MAX_POINTS // 2)
    first = np.cumsum([0, *(part.size for part in parts[:-1])])
    low = first + [int(part.argmin()) for part in parts]
    high = first + [int(part.argmax()) for part in parts]
    return np.unique(np.concatenate([[0], low, high, [value.size - 1]]))
