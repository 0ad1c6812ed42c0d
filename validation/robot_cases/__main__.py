"""Command line of the cases: `python -m validation.robot_cases make|solve|score`."""

import argparse
import json
import sys
from pathlib import Path

from marsarm.common.pool import local_runner
from simgap.common.errors import UserError
from simgap.common.progress import show_progress
from validation.robot_cases.make import make_cases
from validation.robot_cases.score import score_folder
from validation.robot_cases.solve import solve_cases


def main() -> int:
    """Make, solve or score; return 2 if something is wrong with the request, 1 if a bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m validation.robot_cases", description=__doc__)
    verbs = parser.add_subparsers(dest="verb", required=True)
    make = verbs.add_parser("make", help="draw and seal the truth, then write robot files and logs")
    make.add_argument("--seed", type=int, required=True, help="1 or more")
    make.add_argument("--cases", type=int, default=120)
    make.add_argument("--out", type=Path, required=True)
    solve = verbs.add_parser("solve", help="diagnose every case without a result")
    solve.add_argument("folder", type=Path)
    score = verbs.add_parser("score", help="compare the results with the truth")
    score.add_argument("folder", type=Path)
    score.add_argument("--partial", action="store_true", help="score solved cases only")
    score.add_argument("--json", action="store_true", help="print the document instead of the table")
    for verb in (make, solve):
        verb.add_argument("--jobs", type=int, default=2, help="processes (default 2)")
    options = parser.parse_args()
    try:
        return _run(options)
    except UserError as error:
        print(error, file=sys.stderr)
        return 2


def _run(options: argparse.Namespace) -> int:
    if options.verb == "make":
        if options.seed < 1 or options.cases < 1:
            print("make: seed and cases are 1 or more; cases of seed 0 are for tuning", file=sys.stderr)
            return 2
        run = local_runner(options.jobs)
        with show_progress() as progress:
            make_cases(options.out, options.cases, options.seed, run, progress, _publish)
        return 0
    if options.verb == "solve":
        with show_progress() as progress:
            now, all_cases = solve_cases(options.folder, local_runner(options.jobs), progress)
        print(f"{all_cases} cases, {now} of them solved now")
        return 0
    found = score_folder(options.folder, options.partial)
    print(json.dumps(found, indent=1) if options.json else _table(found))
    return 0 if found["in_bounds"] else 1


def _table(found: dict[str, object]) -> str:
    bars = found["bars"]
    assert isinstance(bars, dict)
    rows = [
        f"| {name} | {bar['wanted']} | {bar['hits']} of {bar['of']} | {'met' if bar['met'] else 'missed'} |"
        for name, bar in bars.items()
    ]
    others = [f"{name}: {value}" for name, value in found.items() if name != "bars"]
    return "\n".join(["| | wanted | found | |", "|---|---|---|---|", *rows, "", *others])


def _publish(digest: str) -> None:
    print(f"SHA-256 of the truth: {digest}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
