"""Logs and pictures of docs/results.md; the published logs become what its robot file reads.

Upstream has a folder a motion: control.csv with the commands and state_motor.csv with the measured state, a
row each for the same time stamp, in microseconds. All motions are converted; those that the split file does
not name take no part. Half B is fitted, in two minutes; the motions in the pictures are of half A.
"""

import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from marsarm.render.svg import save_figure
from simgap.arrays import Array
from simgap.assemble import list_base
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
from simgap.selection.context import simulate_models, start_context
from simgap.selection.joint_fits import fit_base
from validation.campaigns import Context, Document

ROBOT: Final = Path(__file__).parents[1] / "models" / "robots" / "so101" / "robot.toml"
FIT: Final = ("end_effector", "center_workspace")
"""Motions of half A that do not touch the table."""
FILES: Final = ("control.csv", "state_motor.csv")
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


def fit(robot: Robot, logs: Logs, found: Audit) -> tuple[list[Trace], dict[str, str]]:
    """Fit base parameters, and simulate the held-out motions of the picture; return both."""
    (kind,) = list_kinds(robot, logs.fit, found.usable)
    fitted = kind.make(logs.fit, False)
    context, present = fit_base(start_context(fitted, base_effects(robot, logs), (), 1, Meter()))
    base = {
        f"{one.place}: {one.name}": f"{one.value:.3f} ({one.interval[0]:.3f} to {one.interval[1]:.3f})"
        + ("" if one.is_identifiable else ", not identifiable")
        for one in list_base(robot, context, present, ())
    }
    shown = [one for name in FIT for one in logs.judged if one.name == name]
    judged = SimulationResiduals(robot, shown, keep=found.usable)
    rows = simulate_models(context, judged, [0.0 * present.sizes, present.sizes])
    traces = []
    for k, name in enumerate(judged.motions):
        of_joint = judged.joint_of == judged.joints.index(JOINT)
        at = np.flatnonzero(of_joint & (judged.motion_of == k) & (judged.time_s < SHOWN_S))
        traces.append(Trace(name, judged.time_s[at], judged.measured_rad[at], *rows[:, at]))
    return traces, base


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
    logs = [motion.joints[name].command for name in names]
    sent = np.column_stack([np.interp(time_s, log.time_s, log.value) for log in logs if log])
    (plane,) = (one for one in found.remarks if one.kind is RemarkKind.CONTACT)
    axes = figure.subplots()
    top, bottom = axes.get_xaxis_transform(), ~found.is_usable(motion.name, JOINT)
    grey = {"transform": top, "color": "0.92", "linewidth": 0}
    axes.fill_between(time_s, 0, 1, where=bottom, label="left out by the audit", **grey)
    axes.plot(time_s, 1e3 * site_heights(robot, names, sent), color=SENT, label="commanded")
    axes.plot(time_s, 1e3 * site_heights(robot, names, measured), color=FITTED, label="measured")
    axes.axhline(1e3 * plane.value, color=NOMINAL, linewidth=0.8, linestyle="--", label="table, as named")
    axes.set(xlabel="time [s]", ylabel="height of gripperframe [mm]", title=motion.name)
    figure.legend(loc="outside lower center", ncols=4, fontsize=9)


def convert(folder: Path, joints: tuple[str, ...]) -> pa.Table:
    """Read all motions of a folder, in the order of their names, by the names of the joints in the logs.

    RobotError if there is none, a file is missing, or the rows of a motion do not agree.
    """
    tables = []
    names = sorted({one.parent.name for file in FILES for one in folder.glob(f"*/{file}")})
    if not names:
        files = " and ".join(FILES)
        raise RobotError(f"{folder}: has no folder of a motion, with {files}; name the folder above")
    for name in names:
        (time_s, command), (_, position, velocity) = (
            _read(folder / name / FILES[0], len(joints), ["positions"]),
            _read(folder / name / FILES[1], len(joints), ["positions", "velocities"]),
        )
        if len(command) != len(position):
            raise RobotError(f"{folder / name}: has {len(command)} commands and {len(position)} states")
        columns: dict[str, pa.Array] = {"log": pa.array([name] * len(command)), "t_s": pa.array(time_s[:, 0])}
        for what, values in {"command": command, "position": position, "velocity": velocity}.items():
            columns |= {f"{what}_{one}": pa.array(values[:, j]) for j, one in enumerate(joints)}
        tables.append(pa.table(columns))
    return pa.concat_tables(tables)


def _read(path: Path, n_joints: int, names: list[str]) -> tuple[Array, ...]:
    """Return the times (n, 1) [s] and the lists of each row, (n, n_joints) a column."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        time_s = np.array([[1e-6 * float(row["timestamp"])] for row in rows])
        lists = (np.array([json.loads(row[name]) for row in rows], dtype=float) for name in names)
        found = (time_s, *(one.reshape(len(rows), n_joints) for one in lists))
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise RobotError(
            f"{path}: is no log of the SO-101 ({error}); name the folder with its motions"
        ) from error
    return found


def campaign(context: Context, logs: Path, convert_only: bool = False) -> Document:
    """Convert the logs unless they are converted, and draw both pictures.

    Args:
        context: Its folder takes the pictures, and the converted logs.
        logs: Published folder with a folder a motion, or the Parquet file made of it.
        convert_only: Draw nothing.
    """
    robot, out = Robot.from_toml(ROBOT), context.out or Path()
    if logs.is_dir():
        joints = tuple(one.name for one in robot.joints)
        table = convert(logs, joints)
        logs = out / "so101.parquet"
        pq.write_table(table, logs)
    if convert_only:
        return {"logs": str(logs)}
    read = load(robot, [logs], split="fit_b")
    found = audit(robot, read)
    touching = next(one for one in read.judged if one.name == CONTACT)
    traces, base = fit(robot, read, found)
    save_figure(out / "so101-table.png", (7.5, 3.2), partial(draw_contact, robot, touching, found))
    save_figure(out / "so101-lift.png", (9.0, 4.6), partial(draw_fit, traces))
    return {"base_parameters": base, "in_bounds": True}
