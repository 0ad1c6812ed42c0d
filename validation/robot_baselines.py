"""Worth of a diagnosis of a robot: errors of the diagnosis and of simpler fits on held-out motions.

Every fit reads the same motions with the same loss; only the effects differ. Effects at a body take no part.
The errors are mean absolute residuals of motions that took no part, by joint.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

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
from simgap.selection.checkpoint import Meter
from simgap.selection.context import start_context
from simgap.selection.joint_fits import fit_base
from validation.campaigns import Context, Document

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


def campaign(context: Context, robot: Path, logs: str, split: str = "", fits: int = len(FITS)) -> Document:
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
