"""All about joint angles in one document: hardstops, backlash, and where joints fall to the other side."""

import json
import sys

from validation import backlash, hardstops, shoulder_in
from validation.options import campaign_parser

EXAMPLE = "example: python -m validation.joints --arms 4 --repeats 50 --tours 20 > joints.json"


def main() -> int:
    """Print the result as JSON; exit status 1 if a part of it is out of its bounds."""
    options = campaign_parser("joints", __doc__, EXAMPLE)
    options.add_argument("--arms", type=int, default=4, help="as-built arms for the hardstops (default 4)")
    options.add_argument("--repeats", type=int, default=50, help="times each (default 50)")
    options.add_argument("--tours", type=int, default=20, help="tours of 50 poses (default 20)")
    asked = options.parse_args()
    if min(asked.arms, asked.tours, asked.workers) < 1 or asked.repeats < 2 or asked.seed < 0:
        options.error("arms, tours and workers are 1 or more, repeats 2 or more, the seed is not negative")
    document = {
        "hardstops": hardstops.campaign(asked.arms, asked.repeats, asked.seed, asked.workers),
        "backlash": backlash.campaign("nominal", asked.tours, 50, asked.seed, asked.workers),
        "shoulder_in": shoulder_in.document(shoulder_in.predictions(asked.seed, asked.workers)),
    }
    print(json.dumps(document, indent=2))
    return 0 if all(part["in_bounds"] for part in document.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
