"""Campaign of the error budget: sampled arms, before calibration and on Mars, and calibrated arms on Mars.

Sampled arms have every source of a case at its magnitude, and one place each, so that intervals are exact.
Many are computed by statics, some of the same in the closed loop. Calibrated arms find their hardstops and
move to twenty places each, cold, with the sources that the budget adds for Mars. The exit status is 1 if a
result is out of its bounds.
"""

import json
import sys
from dataclasses import asdict, replace
from math import radians
from pathlib import Path
from typing import Any, Final

import numpy as np

from marsarm.accuracy.budget import COMPONENTS, MOMENTS
from marsarm.accuracy.monte_carlo import MonteCarloReport, run_monte_carlo
from marsarm.accuracy.monte_carlo_report import monte_carlo_document
from marsarm.accuracy.propagation import COVERAGE
from marsarm.accuracy.request import MonteCarloRequest
from simgap.common.report import to_json
from validation.options import campaign_parser

EXAMPLE = "example: python -m validation.monte_carlo --statics 2000 --closed-loop 100 --calibrated 5"
MOST_WIDE: Final = 1.3
"""Largest ratio of the bound of the budget to the observed bound of 99.73 % of the errors."""
FEWEST_FOR_WIDTH: Final = 1 / (1 - COVERAGE)
"""Least number of arms for this ratio: with fewer, no error is expected beyond the observed bound."""
ACCURACY: Final = {"total_m": 0.0140, "lateral_m": 0.0127, "axial_rad": radians(1.1)}
REPEATABILITY: Final = {"lateral_m": 0.0077, "normal_m": 0.0050, "axial_rad": radians(1.0)}
"""Three sigma on Mars, Table 4 of the paper; the goal is half of it."""
PLACES: Final = 20
MOST_DIFFERENCE_M: Final = 3e-4
"""Largest difference between statics and closed loop with the same sampled errors, on the same sides."""
MOST_OTHER_SIDES: Final = 0.1
"""Share of arms with an output on another side of its backlash: loads are near its friction that often."""


def against_budget(case: str, options: Any) -> dict[str, Any]:
    """Run sampled arms of a case, by statics and in the closed loop."""
    base = MonteCarloRequest(case=case, seed=options.seed, workers=options.workers, cluster=options.cluster)
    many = _run(replace(base, move_model="statics", arms=options.statics), options.results)
    some = _run(replace(base, move_model="closed-loop", arms=options.closed_loop), options.results)
    pairs = [(a[0], b[0]) for a, b in zip(many.trials, some.trials, strict=False)]
    # near the friction limit, statics cannot tell the side of a backlash
    same_side = [np.abs(a.backlash_position - b.backlash_position).max() < 0.5 for a, b in pairs]
    difference_m = [
        float(np.linalg.norm((a.error - b.error)[3:]))
        for (a, b), is_same in zip(pairs, same_side, strict=True)
        if is_same
    ]
    return {
        "statics": {**monte_carlo_document(many), "in_bounds": _rule_holds(many)},
        "closed-loop": {**monte_carlo_document(some), "in_bounds": _rule_holds(some)},
        "statics_difference_m": {
            "rms": float(np.sqrt(np.mean(np.square(difference_m)))),
            "max": max(difference_m),
            "sides_differ": same_side.count(False),
            "in_bounds": max(difference_m) < MOST_DIFFERENCE_M
            and same_side.count(False) <= max(1, MOST_OTHER_SIDES * len(pairs)),
        },
    }


def calibrated(options: Any) -> dict[str, Any]:
    """Run calibrated arms on Mars."""
    request = MonteCarloRequest(
        case="mars",
        built="calibrated",
        arms=options.calibrated,
        places=PLACES,
        seed=options.seed,
        workers=options.workers,
        cluster=options.cluster,
    )
    report = _run(request, options.results)
    if report.three_sigma is None:
        return {"failed": dict(report.failed), "in_bounds": False}
    shares = [report.three_sigma[name].accuracy.upper / most for name, most in ACCURACY.items()]
    shares += [report.three_sigma[name].repeatability.upper / most for name, most in REPEATABILITY.items()]
    return {
        "arms": len(report.trials),
        "places": PLACES,
        "failed": dict(report.failed),
        "three_sigma": {name: asdict(values) for name, values in report.three_sigma.items()},
        "max_bound_ratio": max(shares),
        "goal_met": max(shares) <= 0.5,
        "in_bounds": max(shares) <= 1.0 and not report.failed,
    }


def _rule_holds(report: MonteCarloReport) -> bool:
    """Check that the bounds of the budget cover enough errors and are not too wide."""
    found = [report.coverage.by_rule[MOMENTS][name] for name in COMPONENTS] if report.coverage else []
    checks_width = len(report.trials) >= FEWEST_FOR_WIDTH
    return bool(found) and all(
        c.holds(COVERAGE) and (c.width <= MOST_WIDE or not checks_width) for c in found
    )


def _run(request: MonteCarloRequest, folder: Path | None) -> MonteCarloReport:
    name = f"{request.case}-{request.built}-{request.move_model}.jsonl"

    def progress(done: float, total: float, what: str) -> None:
        print(f"\r{name[:-6]}: {done:g} of {total:g} {what} ", end="", file=sys.stderr)

    found = run_monte_carlo(replace(request, results=folder and folder / name), progress)
    print(file=sys.stderr)
    return found


def document(options: Any) -> dict[str, Any]:
    """Run the whole campaign."""
    found = {case: against_budget(case, options) for case in ("accuracy", "mars")}
    return {**found, "calibrated": calibrated(options)} if options.calibrated else found


def _out_of_bounds(found: Any, name: str = "") -> list[str]:
    """List the parts of a document that are out of their bounds."""
    if not isinstance(found, dict):
        return []
    below = [part for key, value in found.items() for part in _out_of_bounds(value, f"{name} {key}".strip())]
    return below if found.get("in_bounds", True) else [name, *below]


def main() -> None:
    """Print the result as JSON; exit with 1 if a part is out of its bounds."""
    parser = campaign_parser("monte_carlo", __doc__, EXAMPLE)
    for name, count in (("--statics", 10_000), ("--closed-loop", 1000), ("--calibrated", 50)):
        parser.add_argument(name, type=int, default=count, help="arms (default %(default)s)")
    parser.add_argument(
        "--results", type=Path, help="folder of results, from which an interrupted run continues"
    )
    found = document(parser.parse_args())
    print(json.dumps(to_json(found), indent=2))
    out = _out_of_bounds(found)
    if out:
        sys.exit(f"out of bounds: {', '.join(out)}")


if __name__ == "__main__":
    main()
