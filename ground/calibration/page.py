"""A calibration as a page: the paper's Figure 7, what was found, what could not be, what it is good for."""

from pathlib import Path
from typing import Any

import numpy as np

from fsw.kinematics.transforms import Array
from ground.calibration.arm_model import arm_model
from ground.calibration.calibrate import Calibration
from ground.calibration.parameter_file import provenance
from ground.calibration.request import CalibrateReport
from ground.calibration.tables import confused_words, place_rows, summary_rows, zero_rows
from ground.render.figures import drawn
from ground.render.page import heading, image, paragraph, save_page, table


def save_calibration_page(report: CalibrateReport, path: Path) -> None:
    """Write the page.

    Raises:
        BadOutput: the file cannot be written.
    """
    found = report.found
    words = [confused_words(group) for group in found.frames_seen.confused()]
    parts = [
        table(("", ""), summary_rows(found)),
        heading("Pose by pose"),
        paragraph(
            "Shaded: shoulder-in poses. Grey: calibrated numbers, but every output always on one side of its "
            "gap, as if the backlash state were not known."
        ),
        image(drawn((12, 7), 110, lambda figure: _draw_errors(figure, found)), "errors before and after"),
        heading("Encoder zeros"),
        table(("joint", "zero (rz of its frame)", "hardstop at"), zero_rows(found)),
        heading("How well combinations of the 42 frame numbers are seen"),
        image(drawn((12, 3.2), 110, lambda figure: _draw_seen(figure, found)), "singular values"),
        paragraph("Told apart by no pose of this campaign, and left by the drawing:"),
        *(paragraph(one) for one in words),
    ]
    if report.verification is not None:
        head = ("", "rms", "largest", "lateral", "axis")
        parts += [heading("Fresh targets, full turret"), table(head, place_rows(report.verification))]
    parts += [heading("Where it comes from"), *(paragraph(line) for line in provenance(found))]
    save_page(f"Calibration of {found.campaign.arm_name}", parts, path)


def without_state(found: Calibration) -> Array:
    """Error screws (6, n) with the calibrated numbers, the backlash state left out of the prediction."""
    model = arm_model(found.nominal, found.campaign, with_backlash=False)
    return model.errors(found.best.values)


def _draw_errors(figure: Any, found: Calibration) -> None:
    of_position, of_turn = figure.subplots(2, 1, sharex=True)
    series = (
        ("uncalibrated", found.before, "tab:red", "o"),
        ("calibrated, backlash state left out", without_state(found), "0.55", "x"),
        ("calibrated", found.after, "tab:blue", "."),
    )
    for axes, part, label in (
        (of_position, slice(3, 6), "position [mm]"),
        (of_turn, slice(0, 3), "turn [mrad]"),
    ):
        for name, error, colour, marker in series:
            size = 1e3 * np.linalg.norm(error[part], axis=0)
            axes.plot(size, marker, color=colour, label=name, markersize=4)
        _shade(axes, found)
        axes.set(ylabel=label, ylim=(0, None))
        unknown = np.flatnonzero(found.unknown.any(axis=0))
        off = 1e3 * np.linalg.norm(found.after[part][:, unknown], axis=0)
        name = "calibrated, a side of a gap unknown"
        axes.plot(unknown, off, "o", color="tab:blue", fillstyle="none", label=name, markersize=6)
    out = np.flatnonzero(~found.best.used)
    if out.size:
        left_out = 1e3 * np.linalg.norm(found.after[3:, out], axis=0)
        of_position.plot(out, left_out, "ko", fillstyle="none", label="outlier")
    of_position.legend(fontsize=8, ncols=3, loc="upper left")
    of_turn.set(xlabel="pose, in the order in which they were taken")


def _shade(axes: Any, found: Calibration) -> None:
    for k, branch in enumerate(found.campaign.branch):
        if branch.startswith("shoulder-in"):
            axes.axvspan(k - 0.5, k + 0.5, color="0.92", linewidth=0)
    for last in np.flatnonzero(np.diff(found.campaign.group)):
        axes.axvline(last + 0.5, color="0.7", linewidth=0.8)


def _draw_seen(figure: Any, found: Calibration) -> None:
    axes, values = figure.subplots(), found.frames_seen.singular_values
    rank = found.frames_seen.rank
    shown = np.maximum(values, 1e-3)
    axes.semilogy(np.arange(1, rank + 1), shown[:rank], "o", color="tab:blue", label="seen")
    axes.semilogy(np.arange(rank + 1, values.size + 1), shown[rank:], "o", color="tab:red", label="not seen")
    axes.axvline(rank + 0.5, color="0.7", linewidth=0.8)
    axes.set(xlabel=f"combination; {rank} of {values.size} are seen", ylabel="sigmas at its scale")
    axes.legend(fontsize=8)
