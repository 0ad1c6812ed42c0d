"""Brief run of the cases: make, seal, solve and score two cases of the pendulum in a minute."""

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from marsarm.common.pool import local_runner
from simgap.common.progress import no_progress
from validation.options import campaign_parser
from validation.robot_cases.make import make_cases
from validation.robot_cases.score import score_folder
from validation.robot_cases.solve import solve_cases

CASES: Final = 2
"""One without effect and one with a single effect."""
EXAMPLE: Final = "example: python -m validation.robot_cases.brief --seed 3"


def run_brief(folder: Path, seed: int) -> dict[str, Any]:
    """Make, solve and score; return the document. Two cases test no rate, so only a false alarm counts."""
    run = local_runner(1)
    make_cases(folder, CASES, seed, run, no_progress, lambda _: None, ("pendulum",))
    solve_cases(folder, run, no_progress)
    found = score_folder(folder, partial=False)
    return {**found, "in_bounds": not found["bars"]["false alarms"]["hits"]}


def main() -> int:
    """Print the score as JSON; exit status 1 if the case without effect got a name."""
    options = campaign_parser("robot_cases.brief", __doc__, EXAMPLE, with_pool=False).parse_args()
    with TemporaryDirectory() as folder:
        found = run_brief(Path(folder), max(options.seed, 1))
    print(json.dumps(found, indent=2))
    return 0 if found["in_bounds"] else 1


if __name__ == "__main__":
    sys.exit(main())
