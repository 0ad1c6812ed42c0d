"""Compare a diagnosis with simpler fits on held-out motions: gain alone, friction, everything free.

Every fit reads the same motions with the same loss; only the effects differ. Effects at a body take no part.
The errors are mean absolute residuals of motions that took no part, by joint.
"""

import json
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

import numpy as np

from simgap.assemble import simulate_models
from simgap.catalogue.catalogue import base_effects, catalogue
from simgap.checks.audit import audit
from simgap.checks.records import Audit
from simgap.common.errors import RobotError
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
from validation.options import campaign_parser

EXAMPLE: Final = (
    "example: python -m validation.robot_baselines models/robots/pendulum/robot.toml xl330.parquet"
)
BASE: Final = (GainError, Armature, ViscousFriction, CoulombFriction)
LADDER: Final[dict[str, tuple[type[Effect], ...]]] = {
    "gain alone": (GainError,),
    "viscous friction": (GainError, Armature, ViscousFriction),
    "base parameters": BASE,
    "and Stribeck friction": (*BASE, StribeckFriction),
    "and load-dependent friction": (*BASE, StribeckFriction, LoadFriction),
}


@dataclass(frozen=True, slots=True)
class Baseline:
    """Errors of one fit."""

    name: str
    mean_abs: dict[str, float]
    """Mean absolute residual of held-out motions by joint, in the unit of the residual."""
    cpu_s: float


def fit_baselines(robot: Robot, logs: Logs, found: Audit) -> Iterator[Baseline]:
    """Fit sets of effects without a selection.

    Args:
        logs: Motions that are fitted, and motions that judge.
        found: Audit of all motions.

    Yields:
        The fits of the ladder, then the one with everything free.
    """
    (kind, *_) = list_kinds(robot, logs.fit, found.usable)
    fitted, judged = kind.make(logs.fit, False), kind.make(logs.judged, True)
    known = [*base_effects(robot, logs), *catalogue(robot, logs)]
    shown = [one for one in known if kind.shows(one) and one.place in fitted.joints]
    for name in (*LADDER, "everything free"):
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
        yield Baseline(name, error, spent_s)


def diagnose_baseline(robot: Robot, logs: Logs, found: Audit) -> tuple[Baseline, list[str]]:
    """Diagnose, and return the errors and the keys of the findings."""
    began = time.process_time()
    result = diagnose(robot, logs.fit, held_out=logs.judged, audit=found, seed=1)
    error = {one.joint: one.explained for one in result.errors}
    keys = [f"{one.place}: {one.effect}" for one in result.findings]
    return Baseline("diagnosis", error, time.process_time() - began), keys


def main() -> int:
    """Fit, compare and print the errors as JSON."""
    parser = campaign_parser("robot_baselines", __doc__, EXAMPLE, with_pool=False)
    parser.add_argument("robot", type=Path, help="robot file")
    parser.add_argument("logs", type=Path, nargs="+", help="log files")
    parser.add_argument("--split", help="split of the robot's split file; the default one if absent")
    options = parser.parse_args()
    try:
        robot = Robot.from_toml(options.robot)
        logs = load(robot, options.logs, split=options.split or "")
    except RobotError as error:
        print(error, file=sys.stderr)
        return 2
    found, fits = audit(robot, logs), []
    for one in fit_baselines(robot, logs, found):
        print(
            f"robot_baselines: {one.name}: {one.mean_abs}, {one.cpu_s:.0f} CPU s", file=sys.stderr, flush=True
        )
        fits.append(one)
    last, keys = diagnose_baseline(robot, logs, found)
    report = {"robot": robot.name, "fits": [asdict(one) for one in (*fits, last)], "findings": keys}
    print(json.dumps(report, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
