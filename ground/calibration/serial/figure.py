"""The picture of a calibrated serial arm: what is left before and after, and what its joints err by."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from ground.calibration.serial.amounts import wave_rad
from ground.calibration.serial.joints import ALONE
from ground.calibration.serial.ladder import Step
from ground.calibration.serial.model import WAVES
from ground.calibration.serial.request import SerialReport
from ground.render.figures import save_figure

BLUE: Final = "#31688e"
COLOURS: Final = ("0.7", "#d95f02", BLUE)
GAP_RAD: Final = 0.03
"""Between two angles that a joint stood at, beyond which its curve is not drawn."""
COLUMNS: Final = 3


def save_serial_figure(report: SerialReport, path: Path) -> str | None:
    """Save the picture as PNG; the reason if matplotlib is not there.

    Raises:
        BadOutput: the file cannot be written.
    """
    joints = len(report.arm.links) if WAVES in report.steps[-1].terms else 0
    rows = -(-joints // COLUMNS)

    def draw(figure: Any) -> None:
        grid = figure.add_gridspec(1 + rows, COLUMNS, height_ratios=[1.6, *[1.0] * rows])
        _draw_errors(figure.add_subplot(grid[0, :]), report)
        for k in range(joints):
            _draw_joint(figure.add_subplot(grid[1 + k // COLUMNS, k % COLUMNS]), report, k)

    return save_figure(path, (12.0, 4.0 + 2.4 * rows), 100, draw)


def _draw_errors(axes: Any, report: SerialReport) -> None:
    count = report.part.count
    for step, colour in zip(_shown(report), COLOURS, strict=False):
        axes.plot(_errors_mm(step), ".", markersize=2, color=colour, label=_words(step))
    axes.axvline(count, color="black", linewidth=1)
    axes.text(count, 0.02, " held out", transform=axes.get_xaxis_transform())
    axes.text(count, 0.02, "fitted ", transform=axes.get_xaxis_transform(), ha="right")
    axes.set(xlabel="pose, in order of time", ylabel="position error [mm]", yscale="log", ylim=(0.005, 10))
    axes.set_title(f"{report.arm.name}: distance of the target from where the model has it")
    axes.legend(markerscale=5, loc="upper left", ncols=3, fontsize="small")


def _shown(report: SerialReport) -> list[Step]:
    """Before, with the first term, and with all."""
    steps = report.steps
    return [*steps[:2], *steps[2:][-1:]]


def _errors_mm(step: Step) -> Any:
    fresh = [] if step.fresh is None else [step.fresh.position_m]
    return np.concatenate([step.fitted.position_m, *fresh]) * 1e3


def _words(step: Step) -> str:
    said = ", ".join(step.terms) if step.terms else "base and target only"
    shown, where = (step.fitted, "") if step.fresh is None else (step.fresh, ", held out")
    return f"{said}: {shown.rms_m * 1e3:.2f} mm rms{where}"


def _draw_joint(axes: Any, report: SerialReport, k: int) -> None:
    """The waves of a joint where it was seen."""
    found = report.steps[-1].found
    one = found.arm.links[k]
    turn = np.mod(report.part.joint_rad[k] + np.pi, 2 * np.pi) - np.pi
    order = np.argsort(turn)
    waves = wave_rad(found.model.features[k][:, len(ALONE) :], one.waves_rad(found.model.orders))
    x, y = turn[order], waves[order] * 1e3
    ends = np.flatnonzero(np.diff(x) > GAP_RAD) + 1
    for piece in np.split(np.arange(x.size), ends):
        axes.plot(np.degrees(x[piece]), y[piece], color=BLUE, linewidth=1)
    axes.set(title=one.name, xlim=(-180, 180), ylabel="error [mrad]", xlabel="angle [deg]")
    axes.set_xticks(range(-180, 181, 90))
    axes.grid(alpha=0.3)
