"""Draw the pictures of docs/robot-so101.md: base parameters fitted to one half, and the table.

Half B is fitted, in two minutes; the motions in the pictures are of half A.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from marsarm.render.svg import save_figure
from simgap.arrays import Array
from simgap.assemble import list_base, simulate_models
from simgap.catalogue.catalogue import base_effects
from simgap.checks.audit import audit
from simgap.checks.limits import site_heights
from simgap.checks.records import Audit, RemarkKind
from simgap.common.errors import RobotError
from simgap.loading import load
from simgap.logs import Logs, Motion
from simgap.residuals.simulation_residuals import SimulationResiduals, list_kinds
from simgap.robot import Robot
from simgap.selection.checkpoint import Meter
from simgap.selection.context import start_context
from simgap.selection.joint_fits import fit_base

EXAMPLE: Final = "example: python -m validation.so101_pictures so101.parquet --out docs"
ROBOT: Final = Path(__file__).parents[1] / "models" / "robots" / "so101" / "robot.toml"
FIT: Final = ("end_effector", "center_workspace")
"""Motions of half A that do not touch the table."""
SHOWN_S: Final = 30.0
JOINT: Final = "shoulder_lift"
CONTACT: Final = "figure_eight"
NOMINAL, FITTED, MEASURED, SENT = "#c1121f", "#31688e", "0.1", "0.6"


@dataclass(frozen=True, slots=True)
class Trace:
    """One joint in one held-out motion."""

    motion: str
    time_s: Array
    measured_rad: Array
    nominal_rad: Array
    """Residual of the model as it is."""
    fitted_rad: Array
    """Residual with base parameters."""


def fit(robot: Robot, logs: Logs, found: Audit) -> list[Trace]:
    """Fit base parameters, print them, and simulate the held-out motions of the picture."""
    (kind,) = list_kinds(robot, logs.fit, found.usable)
    fitted = kind.make(logs.fit, False)
    context, present = fit_base(start_context(fitted, base_effects(robot, logs), (), 1, Meter()))
    for one in list_base(robot, context, present, ()):
        known = "" if one.is_identifiable else ", not identifiable"
        low, high = one.interval
        print(f"{one.place}: {one.name} {one.value:.3f} ({low:.3f} to {high:.3f}){known}")
    shown = [one for name in FIT for one in logs.judged if one.name == name]
    judged = SimulationResiduals(robot, shown, keep=found.usable)
    rows = simulate_models(context, judged, [0.0 * present.sizes, present.sizes])
    traces = []
    for k, name in enumerate(judged.motions):
        at = np.flatnonzero(
            (judged.joint_of == judged.joints.index(JOINT))
            & (judged.motion_of == k)
            & (judged.time_s < SHOWN_S)
        )
        traces.append(Trace(name, judged.time_s[at], judged.measured_rad[at], *rows[:, at]))
    return traces


def draw_fit(traces: Sequence[Trace], figure: Any) -> None:
    """Draw positions above, residuals below, a column a motion."""
    axes = figure.subplots(2, len(traces), sharex="col", sharey="row", height_ratios=(2, 1), squeeze=False)
    for (above, below), one in zip(axes.T, traces, strict=True):
        for residual, colour, label in (
            (one.nominal_rad, NOMINAL, "nominal model"),
            (one.fitted_rad, FITTED, "base parameters of the other half"),
        ):
            above.plot(one.time_s, one.measured_rad - residual, color=colour, linewidth=1.0, label=label)
            below.plot(one.time_s, 1e3 * residual, color=colour, linewidth=0.8)
        above.plot(one.time_s, one.measured_rad, color=MEASURED, linewidth=1.0, label="measured")
        above.set_title(one.motion, fontsize=10)
        below.axhline(0.0, color="0.8", linewidth=0.8)
        below.set_xlabel("time [s]")
    axes[0, 0].set_ylabel("shoulder lift [rad]")
    axes[1, 0].set_ylabel("measured less\nsimulated [mrad]")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=9)


def draw_contact(robot: Robot, motion: Motion, found: Audit, figure: Any) -> None:
    """Draw the height of the gripper's frame, commanded and measured, and what the audit leaves out."""
    names = [one.name for one in robot.joints]
    time_s = motion.joints[JOINT].position.time_s
    measured = np.column_stack([motion.joints[name].position.value for name in names])
    sent = np.column_stack(
        [np.interp(time_s, log.time_s, log.value) for log in (motion.joints[n].command for n in names) if log]
    )
    (plane,) = (one for one in found.remarks if one.kind is RemarkKind.CONTACT)
    axes = figure.subplots()
    top, bottom = axes.get_xaxis_transform(), ~found.is_usable(motion.name, JOINT)
    axes.fill_between(
        time_s, 0, 1, where=bottom, transform=top, color="0.92", linewidth=0, label="left out by the audit"
    )
    axes.plot(time_s, 1e3 * site_heights(robot, names, sent), color=SENT, label="commanded")
    axes.plot(time_s, 1e3 * site_heights(robot, names, measured), color=FITTED, label="measured")
    axes.axhline(1e3 * plane.value, color=NOMINAL, linewidth=0.8, linestyle="--", label="table, as named")
    axes.set(xlabel="time [s]", ylabel="height of gripperframe [mm]", title=motion.name)
    figure.legend(loc="outside lower center", ncols=4, fontsize=9)


def main() -> int:
    """Fit, draw, print the base parameters."""
    parser = argparse.ArgumentParser(
        prog="python -m validation.so101_pictures",
        description=__doc__,
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("logs", type=Path, help="Parquet file of the logs")
    parser.add_argument("--out", type=Path, default=Path("docs"), help="folder (default %(default)s)")
    options = parser.parse_args()
    try:
        robot = Robot.from_toml(ROBOT)
        logs = load(robot, [options.logs], split="fit_b")
    except RobotError as error:
        print(error, file=sys.stderr)
        return 2
    found = audit(robot, logs)
    touching = next(one for one in logs.judged if one.name == CONTACT)
    for problem in (
        save_figure(
            options.out / "so101-table.png", (7.5, 3.2), 100, partial(draw_contact, robot, touching, found)
        ),
        save_figure(
            options.out / "so101-lift.png", (9.0, 4.6), 100, partial(draw_fit, fit(robot, logs, found))
        ),
    ):
        if problem is not None:
            print(f"marsarm: {problem}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
