"""Campaign of the scenarios: each on the nominal arm, on calibrated and on as-built arms, on a tilted rover.

The tilt is the largest that the requirement allows, in a random direction: 30 deg to place an instrument,
20 deg to take and move samples. Every arm is taught its places.
"""

import json
import sys
from dataclasses import asdict, dataclass

import numpy as np

from fsw.dictionary.faults import Fault
from fsw.estimate.reference import Reference
from marsarm.common.pool import Runner, in_order
from sim.arms import arm_named
from sim.initialisation import initial_reference
from sim.loop import ClosedLoop
from sim.scenario.data import Scenario
from sim.scenario.file import built_in_scenarios, load_scenario
from sim.scenario.run import ScenarioRun, scenario_setup, teach
from sim.sequence import Outcome
from validation.options import campaign_parser, campaign_runner

TILT_DEG = {"contact-science": 30.0, "tool-change": 30.0}
"""Tilt in scenarios that place an instrument."""
SAMPLING_TILT_DEG = 20.0
"""Tilt in the other scenarios."""


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


def run_on_arm(name: str, names: tuple[str, ...]) -> list[ScenarioOutcome]:
    """Run scenarios on one arm, after it has found its hardstops."""
    reference = initial_reference(arm_named(name))
    return [run_scenario_on(name, scenario_name, reference) for scenario_name in names]


def run_scenario_on(name: str, scenario_name: str, reference: Reference) -> ScenarioOutcome:
    """Run a scenario on one arm, taught its places; the direction of the tilt depends on both."""
    seed, k = int(name.partition(":")[2] or 0), list(built_in_scenarios()).index(scenario_name)
    tilt = np.radians(TILT_DEG.get(scenario_name, SAMPLING_TILT_DEG)) * (1 - 1e-9)
    heading = float(np.random.default_rng([seed, k, 70]).uniform(-np.pi, np.pi))
    # Roll and pitch that together give this tilt.
    roll = float(np.arcsin(np.sin(tilt) * np.sin(heading)))
    pitch = float(np.arctan(np.tan(tilt) * np.cos(heading)))
    scenario = load_scenario(scenario_name).tilted(roll, pitch)
    return _run(scenario, name, seed, reference)


def _run(scenario: Scenario, name: str, seed: int, reference: Reference) -> ScenarioOutcome:
    arm = arm_named(name)
    arm = teach(arm, reference, scenario.taught, scenario.world)
    loop = ClosedLoop(scenario_setup(scenario, arm, reference, seed))
    run = ScenarioRun(loop, scenario)
    for _ in run:
        pass
    result = run.result()
    return ScenarioOutcome(
        scenario=scenario.name,
        arm=name,
        tilt_deg=tuple(
            np.degrees([scenario.world.tilt_roll_rad, scenario.world.tilt_pitch_rad]).round(1).tolist()
        ),
        outcome=str(result.outcome),
        passed=result.passed,
        failed=tuple(f"{m.check}: {m.name} {m.value:.6g} {m.unit}" for m in result.checks if not m.passed),
        measured={
            f"{m.check}: {m.name} [{m.unit}]": m.value
            for m in result.checks
            if m.unit or m.name.startswith("lateral over")
        },
        faults=tuple(evr.message for _, evr in result.evrs if isinstance(evr, Fault)),
    )


def in_bounds(case: ScenarioOutcome) -> bool:
    """Check an outcome: an as-built arm must complete its scenario, other arms must also pass all checks."""
    return case.outcome == Outcome.DONE if case.arm.startswith("as-built") else case.passed


def summary(ran: list[ScenarioOutcome]) -> dict[str, object]:
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
                "range": {name: [min(v), max(v)] for name, v in values.items()},
            }
    failed = [asdict(r) for r in ran if not r.passed]
    return {"table": table, "failed": failed, "in_bounds": all(map(in_bounds, ran))}


def document(
    calibrated: int, as_built: int, seed: int, run: Runner, only: str | None = None
) -> dict[str, object]:
    """Run every scenario, or only one, on the nominal arm and on this many others."""
    names = (only,) if only else tuple(built_in_scenarios())
    arms = ["nominal"]
    arms += [f"calibrated:{seed + k}" for k in range(1, calibrated + 1)]
    arms += [f"as-built:{seed + k}" for k in range(1, as_built + 1)]
    ran: list[ScenarioOutcome] = []
    for k, found in enumerate(in_order(run, run_on_arm, ((arm, names) for arm in arms)), start=1):
        ran += found
        failed = [
            f"{case.scenario}: {', '.join(case.failed) or case.outcome}" for case in found if not case.passed
        ]
        print(
            f"{k} of {len(arms)}, {arms[k - 1]}: {'; '.join(failed) or 'passed'}",
            file=sys.stderr,
            flush=True,
        )
    return summary(ran)


def main() -> int:
    """Print the result as JSON; return 1 if a scenario is out of its bounds."""
    parser = campaign_parser(
        "scenarios", __doc__, "example: python -m validation.scenarios --calibrated 2 --as-built 0"
    )
    parser.add_argument("--calibrated", type=int, default=20, help="calibrated arms (default %(default)s)")
    parser.add_argument("--as-built", type=int, default=20, help="as-built arms (default %(default)s)")
    parser.add_argument("--only", choices=list(built_in_scenarios()), help="one scenario, in place of all")
    options = parser.parse_args()
    found = document(
        options.calibrated, options.as_built, options.seed, campaign_runner(options), options.only
    )
    print(json.dumps(found, indent=2))
    return 0 if found["in_bounds"] else 1


if __name__ == "__main__":
    sys.exit(main())
