"""The five jobs of the arm in one document: scenarios, tool changes, contacts, and what stops them."""

import json
import sys

from validation import contact, faults, scenarios, tool_change
from validation.options import campaign_parser

EXAMPLE = "example: python -m validation.jobs --arms 2 --changers 2 --faults 60 > jobs.json"


def main() -> int:
    """Print the result as JSON; exit status 1 if a part of it is out of its bounds."""
    options = campaign_parser("jobs", __doc__, EXAMPLE)
    options.add_argument(
        "--arms", type=int, default=20, help="arms of each kind for the scenarios (default 20)"
    )
    options.add_argument(
        "--changers", type=int, default=50, help="calibrated arms for the tool changes (default 50)"
    )
    options.add_argument("--faults", type=int, default=1000, help="faults in all (default 1000)")
    asked = options.parse_args()
    document = {
        "scenarios": scenarios.document(asked.arms, asked.arms, asked.seed, asked.workers),
        "tool_changes": tool_change.document(asked.changers, asked.arms, asked.seed, asked.workers),
        "contacts": contact.document(asked.arms, asked.seed, asked.workers),
        "faults": faults.document(asked.faults, asked.seed, asked.workers),
    }
    print(json.dumps(document, indent=2))
    return 0 if all(part["in_bounds"] for part in document.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
