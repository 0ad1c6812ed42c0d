"""Campaign of the scenarios: each is done on many arms, and the log of each replays with equal outputs.

The tilt is the largest that the requirement allows, in a random direction: 30 deg to place an instrument,
20 deg to take and move samples. Every arm is taught its places.

An as-built arm flies with the parameters of its drawing. What it has touched, was taught or measures itself
is judged as on other arms: forces, the spot of another tool, bit boxes, inlets, the stowed pose. What rests
on coordinates alone may be off by as much as its tolerances make likely: a place on a rock, and a direction.
"""

from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fsw.config import configure
from fsw.dictionary.faults import Fault
from fsw.estimate.gear import MARS_GRAVITY_M_S2
from fsw.estimate.reference import Reference
from fsw.kinematics.arm import build_arm
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.statics import settle_output
from fsw.kinematics.transforms import angle_between
from marsarm.replaying.replay import ReplayRequest, replay
from marsarm.telemetry.recorder import Recorder, run_header
from sim.arm_model.load import default_arm
from sim.arms import arm_named, nominal_params
from sim.effects.effect import params_with_effects
from sim.initialisation import initial_reference
from sim.loop import ClosedLoop
from sim.scenario.file import built_in_scenarios, load_scenario
from sim.scenario.judge import CheckResult
from sim.scenario.records import upper_snake
from sim.scenario.run import ScenarioRun, scenario_setup, teach
from sim.tolerances import draw_tolerances
from simgap.common.errors import BadRequest
from validation.campaigns import Context, Document

TILT_DEG = {"contact-science": 30.0, "tool-change": 30.0}
"""Tilt in scenarios that place an instrument."""
SAMPLING_TILT_DEG = 20.0
"""Tilt in the other scenarios."""


DRAWN_ARMS = range(10_000, 10_200)
"""Seeds of the arms whose tool errors give the likely ones; none of them is flown."""
SIGMAS = 3.0
"""Bound of an error in root mean squares of its length."""


@dataclass(frozen=True, slots=True)
class BuiltErrors:
    """Errors of a tool that is sent to coordinates, which as-built arms stay within."""

    lateral_m: float
    """Distance across the approach."""
    direction_rad: float


@cache
def built_errors(tool: str) -> BuiltErrors:
    """Bound the errors of a tool by those of arms drawn from the tolerances, in the ready pose on Mars."""
    params = nominal_params()
    drawn, pose, gravity = (
        build_arm(params),
        np.array(params.poses.ready_rad),
        np.array([0.0, 0.0, MARS_GRAVITY_M_S2]),
    )
    meant = tool_pose(drawn, settle_output(drawn, pose, gravity).frames, tool)
    axis = meant.R[:, 0]
    lateral_m, direction_rad = [], []
    for seed in DRAWN_ARMS:
        true = params_with_effects(draw_tolerances(default_arm(), seed), params)
        arm = build_arm(true)
        # an output stands off by as much as its hardstop
        there = pose + configure(params).hardstop_rad - configure(true).hardstop_rad
        X_RT = tool_pose(arm, settle_output(arm, there, gravity).frames, tool)
        off = X_RT.p - meant.p
        lateral_m.append(np.linalg.norm(off - (off @ axis) * axis))
        direction_rad.append(angle_between(X_RT.R[:, 0], axis))
    most = [SIGMAS * float(np.sqrt(np.mean(np.square(errors)))) for errors in (lateral_m, direction_rad)]
    return BuiltErrors(*most)


def judge_as_built(result: CheckResult, tool: str) -> CheckResult:
    """Return a result with the bound of an as-built arm, where it rests on coordinates alone."""
    match result.check, result.name:
        case "placed", "lateral":
            return replace(result, high=max(result.high, built_errors(tool).lateral_m))
        case "gravity_held", "gravity off":
            return replace(result, high=max(result.high, built_errors(tool).direction_rad))
        case _:
            return result


@dataclass(frozen=True, slots=True)
class ScenarioOutcome:
    """Scenario on an arm."""

    scenario: str
    arm: str
    tilt_deg: tuple[float, float]
    outcome: str
    passed: bool
    failed: tuple[str, ...]
    measured: dict[str, float]
    faults: tuple[str, ...]
    replays: bool | None
    """Whether the log replays without a difference; None if there is none."""


def run_on_arm(name: str, names: tuple[str, ...]) -> list[ScenarioOutcome]:
    """Run scenarios on one arm, after it has found its hardstops, and replay their logs."""
    reference = initial_reference(arm_named(name))
    with TemporaryDirectory() as folder:
        log = Path(folder) / "run.mcap"
        return [run_scenario_on(name, scenario_name, reference, log) for scenario_name in names]


def run_scenario_on(
    name: str, scenario_name: str, reference: Reference, log: Path | None = None
) -> ScenarioOutcome:
    """Run a scenario on one arm, taught its places; the direction of the tilt depends on both."""
    seed, k = int(name.partition(":")[2] or 0), list(built_in_scenarios()).index(scenario_name)
    tilt = np.radians(TILT_DEG.get(scenario_name, SAMPLING_TILT_DEG)) * (1 - 1e-9)
    heading = float(np.random.default_rng([seed, k, 70]).uniform(-np.pi, np.pi))
    # Roll and pitch that together give this tilt.
    roll = float(np.arcsin(np.sin(tilt) * np.sin(heading)))
    pitch = float(np.arctan(np.tan(tilt) * np.cos(heading)))
    scenario = load_scenario(scenario_name).tilted(roll, pitch)
    arm = teach(arm_named(name), reference, scenario.taught, scenario.world)
    loop = ClosedLoop(scenario_setup(scenario, arm, reference, seed))
    run = ScenarioRun(loop, scenario)
    header = run_header(loop, name, seed, {}, scenario.commands)
    with nullcontext() if log is None else Recorder(log, header, loop.config.params) as recorder:
        for record in run:
            if recorder is not None:
                recorder.write(record)
    result = run.result()
    checks = result.checks
    if name.startswith("as-built"):
        tools = {upper_snake(type(check)).lower(): getattr(check, "tool", "") for check in scenario.checks}
        checks = tuple(judge_as_built(found, tools.get(found.check, "")) for found in checks)
    tilt_rad = [scenario.world.tilt_roll_rad, scenario.world.tilt_pitch_rad]
    shown = [m for m in checks if m.unit or m.name.startswith("lateral over")]
    return ScenarioOutcome(
        scenario=scenario.name,
        arm=name,
        tilt_deg=tuple(np.degrees(tilt_rad).round(1).tolist()),
        outcome=str(result.outcome),
        passed=replace(result, checks=checks).passed,
        failed=tuple(f"{m.check}: {m.name} {m.value:.6g} {m.unit}" for m in checks if not m.passed),
        measured={f"{m.check}: {m.name} [{m.unit}]": m.value for m in shown},
        faults=tuple(evr.message for _, evr in result.evrs if isinstance(evr, Fault)),
        replays=None if log is None else replay(ReplayRequest(log)).differences.identical,
    )


def in_bounds(case: ScenarioOutcome) -> bool:
    """Check an outcome: all checks pass, with the bounds of its kind of arm, and its log replays."""
    return case.passed and case.replays is not False


def summary(ran: list[ScenarioOutcome]) -> Document:
    """Summarize outcomes by kind of arm and scenario: counts, ranges of measured values, and failures."""
    table: dict[str, dict[str, object]] = {}
    for kind in sorted({r.arm.partition(":")[0] for r in ran}):
        table[kind] = {}
        for scenario in sorted({r.scenario for r in ran}):
            cases = [r for r in ran if r.scenario == scenario and r.arm.partition(":")[0] == kind]
            if not cases:
                continue
            names = list(dict.fromkeys(name for case in cases for name in case.measured))
            values = {name: [c.measured[name] for c in cases if name in c.measured] for name in names}
            table[kind][scenario] = {
                "arms": len(cases),
                "passed": sum(case.passed for case in cases),
                "replayed": sum(case.replays is True for case in cases),
                "range": {name: [min(v), max(v)] for name, v in values.items()},
            }
    failed = [asdict(r) for r in ran if not in_bounds(r)]
    return {"table": table, "failed": failed, "in_bounds": not failed}


def campaign(context: Context, calibrated: int = 20, as_built: int = 20, only: str = "") -> Document:
    """Run every scenario, or only one, on the nominal arm and on this many others."""
    arms = ["nominal"]
    arms += [f"calibrated:{context.seed + k}" for k in range(1, calibrated + 1)]
    arms += [f"as-built:{context.seed + k}" for k in range(1, as_built + 1)]
    ran = context.each(run_on_arm, ((arm, choose(only)) for arm in arms), "arms")
    return summary([case for found in ran for case in found])


def choose(only: str) -> tuple[str, ...]:
    """Return the names of all scenarios, or one; BadRequest if it is none."""
    if only and only not in built_in_scenarios():
        raise BadRequest(f"set only: there are {', '.join(built_in_scenarios())}")
    return (only,) if only else tuple(built_in_scenarios())
