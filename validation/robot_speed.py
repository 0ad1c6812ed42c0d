"""Cost and worth of a diagnosis of a robot: CPU time, and simpler fits.

Cost: cases of the pendulum and of the arm with two joints are drawn from tuning seeds; motions are left out
at the end. Costs are CPU seconds of one process. docs/robot-cost.png shows them.

Baselines: every fit reads the same motions with the same loss; only the effects differ. Effects at a body
take no part. The errors are mean absolute residuals of motions that took no part, by joint.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np

from marsarm.render.svg import save_figure
from simgap.catalogue.catalogue import base_effects, catalogue
from simgap.checks.audit import audit
from simgap.checks.records import Audit
from simgap.diagnosis import diagnose
from simgap.effects.actuation import GainError
from simgap.effects.effect import Effect
from simgap.effects.forces import CoulombFriction, LoadFriction, StribeckFriction, ViscousFriction
from simgap.effects.inertia import Armature
from simgap.loading import load
from simgap.logs import Logs
from simgap.residuals.simulation_residuals import list_kinds
from simgap.robot import Robot
from simgap.selection.checkpoint import Meter, Progress
from simgap.selection.context import start_context
from simgap.selection.joint_fits import fit_base
from validation.campaigns import Context, Document, keep_results
from validation.cases.robot_draw import Kind, draw_case
from validation.cases.robot_setup import PERIOD_S, SAMPLES

MODELS: Final = {"pendulum": "pendulum", "two_joint": "arm with two joints"}
KINDS: Final[tuple[Kind, ...]] = ("none", "single", "pair")
FITTED: Final = (4, 6, 8)
"""Numbers of fitted motions; a diagnosis needs four."""
DIAGNOSIS_SEED: Final = 1
"""Seed of the diagnosis, independent of that of the cases."""


@dataclass(frozen=True, slots=True)
class Setting:
    """Case, and the number of its motions that are fitted."""

    model: str
    kind: Kind
    motions: int

    @property
    def name(self) -> str:
        return f"{self.model}, {self.kind}, {self.motions} motions"


SETTINGS: Final = tuple(Setting(*one) for one in product(MODELS, KINDS, FITTED))


def measure(setting: Setting, seed: int, progress: Progress) -> Document:
    """Diagnose a case; return its cost."""
    robot, logs, _ = draw_case(seed, setting.kind, setting.model)
    began = time.process_time()
    found = diagnose(
        robot, logs.fit[: setting.motions], held_out=logs.judged, seed=DIAGNOSIS_SEED, progress=progress
    )
    return {
        "model": setting.model,
        "effects": KINDS.index(setting.kind),
        "log_s": setting.motions * SAMPLES * PERIOD_S,
        "cpu_s": time.process_time() - began,
        "findings": len(found.findings),
    }


def plot(rows: list[dict[str, Any]], figure: Any) -> None:
    """Plot a panel a model, and a line a number of effects."""
    for model, axes in zip(MODELS, figure.subplots(1, len(MODELS), sharey=True), strict=True):
        for effects in range(len(KINDS)):
            mine = [row for row in rows if (row["model"], row["effects"]) == (model, effects)]
            label = f"{effects} effect{'' if effects == 1 else 's'}"
            if mine:
                axes.plot([row["log_s"] for row in mine], [row["cpu_s"] for row in mine], "o-", label=label)
        axes.set_title(MODELS[model])
        axes.set_xlabel("fitted log [s]")
        axes.set_xlim(0.0, 1.05 * FITTED[-1] * SAMPLES * PERIOD_S)
        if axes.lines:
            axes.legend(loc="upper left")
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("cost [CPU s]")
    figure.axes[0].set_ylim(bottom=0.0)  # after the last panel, because it ends the common scaling


def cost(context: Context, settings: int = len(SETTINGS)) -> Document:
    """Measure the first settings.

    Args:
        context: Its file keeps results, from which an interrupted campaign goes on; the plot goes beside it.
        settings: Number of settings.
    """
    rows = []
    with keep_results(context.out, context.seed) as once:
        for done, setting in enumerate(SETTINGS[:settings]):

            def tell(share: float, text: str, done: int = done, name: str = setting.name) -> None:
                context.progress(done + share, settings, f"{name}: {text}")

            rows.append(once(setting.name, partial(measure, setting, context.seed, tell)))
    if context.out is not None:
        save_figure(context.out.with_suffix(".png"), (8.0, 3.4), 150, partial(plot, rows))
    return {"costs": rows}


BASE: Final = (GainError, Armature, ViscousFriction, CoulombFriction)
LADDER: Final[dict[str, tuple[type[Effect], ...]]] = {
    "model as it is": (),
    "gain alone": (GainError,),
    "viscous friction": (GainError, Armature, ViscousFriction),
    "base parameters": BASE,
    "and Stribeck friction": (*BASE, StribeckFriction),
    "and load-dependent friction": (*BASE, StribeckFriction, LoadFriction),
}
FITS: Final = (*LADDER, "everything free", "diagnosis")
"""From the simplest on."""


@dataclass(frozen=True, slots=True)
class Baseline:
    """Errors of one fit."""

    name: str
    mean_abs: dict[str, float]
    """Mean absolute residual of held-out motions by joint, in the unit of the residual."""
    cpu_s: float


def fit_baselines(robot: Robot, logs: Logs, found: Audit, names: Sequence[str]) -> Iterator[Baseline]:
    """Fit sets of effects without a selection.

    Args:
        logs: Motions that are fitted, and motions that judge.
        found: Audit of all motions.
        names: Fits, by their names in FITS, without the diagnosis.
    """
    (kind, *_) = list_kinds(robot, logs.fit, found.usable)
    fitted, judged = kind.make(logs.fit, False), kind.make(logs.judged, True)
    known = [*base_effects(robot, logs), *catalogue(robot, logs)]
    shown = [one for one in known if kind.shows(one) and one.place in fitted.joints]
    for name in names:
        effects = [one for one in shown if name not in LADDER or isinstance(one, LADDER[name])]
        began, sizes = time.process_time(), np.zeros((1, 0))
        if effects:
            context, present = fit_base(start_context(fitted, effects, (), 1, Meter()))
            sizes = present.sizes[None, context.union.columns(effects)]
        spent_s = time.process_time() - began
        (rows,) = judged.residuals(effects, sizes)
        error = {
            joint: float(np.mean(np.abs(rows[judged.joint_of == j])))
            for j, joint in enumerate(judged.joints)
            if np.any(judged.joint_of == j)
        }
        yield Baseline(name, error, spent_s)


def diagnose_baseline(robot: Robot, logs: Logs, found: Audit) -> tuple[Baseline, list[str]]:
    """Diagnose, and return the errors and the keys of the findings."""
    began = time.process_time()
    result = diagnose(robot, logs.fit, held_out=logs.judged, audit=found, seed=1)
    error = {one.joint: one.explained for one in result.errors}
    keys = [f"{one.place}: {one.effect}" for one in result.findings]
    return Baseline("diagnosis", error, time.process_time() - began), keys


def baselines(context: Context, robot: Path, logs: str, split: str = "", fits: int = len(FITS)) -> Document:
    """Compare a diagnosis with simpler fits on held-out motions.

    Args:
        context: Told of the progress.
        robot: Robot file.
        logs: Log files, with commas.
        split: Split of the robot's split file; the default one if empty.
        fits: Number of fits, from the simplest on; the last is the diagnosis.
    """
    model = Robot.from_toml(robot)
    read = load(model, [Path(one) for one in logs.split(",")], split=split)
    found, made = audit(model, read), list[Baseline]()
    names = [one for one in FITS[:fits] if one != FITS[-1]]
    for one in fit_baselines(model, read, found, names):
        context.progress(len(made), fits, one.name)
        made.append(one)
    document: Document = {}
    if fits >= len(FITS):
        last, document["findings"] = diagnose_baseline(model, read, found)
        made.append(last)
    document["mean_abs"] = {one.name: one.mean_abs for one in made}
    document["cpu_s"] = {one.name: one.cpu_s for one in made}
    return {"robot": model.name, **document}
