"""Compare a diagnosis with simpler fits on held-out motions: gain alone, friction, everything free.

Every fit reads the same motions with the same loss; only the effects differ. Effects at a body take no part.
The errors are mean absolute residuals of motions that took no part, by joint.
"""

import json
import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from diagnosis.assemble import simulate_models
from diagnosis.audit.audit import audit
from diagnosis.catalogue import base_effects, catalogue
from diagnosis.context import start_context
from diagnosis.diagnose import MOST_STEPS, diagnose
from diagnosis.effects.actuation import GainError
from diagnosis.effects.effect import Effect
from diagnosis.effects.friction import CoulombFriction, LoadFriction, StribeckFriction, ViscousFriction
from diagnosis.effects.inertia import Armature
from diagnosis.joint_fits import fit_base
from diagnosis.kinds import list_kinds
from diagnosis.load import load
from diagnosis.logs import Logs
from diagnosis.meter import Meter
from diagnosis.robot import Robot
from validation.options import campaign_parser

EXAMPLE: Final = (
    "example: python -m validation.robot_baselines models/robots/pendulum/robot.toml xl330.parquet"
)
NO_FRICTION: Final = (GainError, Armature)
LADDER: Final[dict[str, tuple[type[Effect], ...]]] = {
    "gain alone": (GainError,),
    "viscous friction": (*NO_FRICTION, ViscousFriction),
    "base parameters": (*NO_FRICTION, ViscousFriction, CoulombFriction),
    "and Stribeck friction": (*NO_FRICTION, ViscousFriction, CoulombFriction, StribeckFriction),
    "and load-dependent friction": (
        *NO_FRICTION,
        ViscousFriction,
        CoulombFriction,
        StribeckFriction,
        LoadFriction,
    ),
}


@dataclass(frozen=True, slots=True)
class Baseline:
    """Errors of one fit."""

    name: str
    mean_abs: dict[str, float]
    """Mean absolute residual of held-out motions by joint, in the unit of the residual."""
    cpu_s: float


def fit_baselines(robot: Robot, logs: Logs, names: Sequence[str]) -> list[Baseline]:
    """Fit sets of effects without a selection.

    Args:
        robot: The robot.
        logs: Motions that are fitted, and motions that judge.
        names: Names of the ladder, or "everything free".

    Returns:
        One record a name.
    """
    found = audit(robot, logs)
    motions = [(motion.name, joint) for motion in logs.motions for joint in motion.joints]
    usable = {pair: found.is_usable(*pair) for pair in motions}
    (kind, *_) = list_kinds(robot, logs.fit, usable)
    fitted, judged = kind.make(logs.fit, MOST_STEPS), kind.make(logs.judged, math.inf)
    known = [*base_effects(robot, logs), *catalogue(robot, logs)]
    shown = [one for one in known if kind.shows(one) and one.place in fitted.joints]
    records = []
    for name in names:
        effects = [one for one in shown if name not in LADDER or isinstance(one, LADDER[name])]
        began = time.process_time()
        context, present = fit_base(start_context(fitted, effects, (), 1, Meter()))
        spent_s = time.process_time() - began
        (rows,) = simulate_models(context, judged, [present.sizes])
        error = {
            joint: float(np.mean(np.abs(rows[judged.joint_of == j])))
            for j, joint in enumerate(judged.joints)
            if np.any(judged.joint_of == j)
        }
        records.append(Baseline(name, error, spent_s))
    return records


def diagnose_baseline(robot: Robot, logs: Logs) -> tuple[Baseline, list[str]]:
    """Diagnose, and return the errors and the keys of the findings."""
    began = time.process_time()
    found = diagnose(robot, logs.fit, held_out=logs.judged, audit=audit(robot, logs), seed=1)
    error = {one.joint: one.explained for one in found.errors}
    keys = [f"{one.place}: {one.effect}" for one in found.findings]
    return Baseline("diagnosis", error, time.process_time() - began), keys


def main() -> int:
    """Fit, compare and print the errors as JSON."""
    parser = campaign_parser("robot_baselines", __doc__, EXAMPLE, with_pool=False)
    parser.add_argument("robot", type=Path, help="robot file")
    parser.add_argument("logs", type=Path, nargs="+", help="log files")
    parser.add_argument("--split", help="split of the robot's split file; the default one if absent")
    options = parser.parse_args()
    robot = Robot.from_toml(options.robot)
    logs = load(robot, options.logs, split=options.split or "")
    report: dict[str, Any] = {"robot": robot.name, "fits": []}
    for name in (*LADDER, "everything free"):
        (one,) = fit_baselines(robot, logs, [name])
        print(f"robot_baselines: {name}: {one.mean_abs}, {one.cpu_s:.0f} CPU s", file=sys.stderr, flush=True)
        report["fits"].append({"name": one.name, "mean_abs": one.mean_abs, "cpu_s": one.cpu_s})
    one, keys = diagnose_baseline(robot, logs)
    report["fits"].append({"name": one.name, "mean_abs": one.mean_abs, "cpu_s": one.cpu_s})
    print(json.dumps({**report, "findings": keys}, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
