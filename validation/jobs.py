"""Campaigns of the jobs of the arm in one document: scenarios, tool changes, contacts, obstacles, faults."""

import json
import sys

from validation import contact, faults, obstacles, scenarios, tool_change
from validation.options import campaign_parser, campaign_runner

EXAMPLE = "example: python -m validation.jobs --arms 2 --changers 2 --faults 60 > jobs.json"


def main() -> int:
    """Print the results as JSON; return 1 if a campaign is out of its bounds."""
    parser = campaign_parser("jobs", __doc__, EXAMPLE)
    parser.add_argument(
        "--arms", type=int, default=20, help="arms of each kind for the scenarios (default 20)"
    )
    parser.add_argument(
        "--changers", type=int, default=50, help="calibrated arms for the tool changes (default 50)"
    )
    parser.add_argument(
        "--obstacles", type=int, default=obstacles.COUNT, help="obstacles in free moves (default %(default)s)"
    )
    parser.add_argument("--faults", type=int, default=1000, help="faults in all (default 1000)")
    options = parser.parse_args()
    run = campaign_runner(options)
    document = {
        "scenarios": scenarios.document(options.arms, options.arms, options.seed, run),
        "tool_changes": tool_change.document(options.changers, options.arms, options.seed, run),
        "contacts": contact.document(options.arms, options.seed, run),
        "obstacles": obstacles.document(options.obstacles, options.seed, run),
        "faults": faults.document(options.faults, options.seed, run),
    }
    print(json.dumps(document, indent=2))
    return 0 if all(part["in_bounds"] for part in document.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
