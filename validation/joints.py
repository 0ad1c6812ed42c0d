"""Campaigns of joint angles in one document: hardstops, backlash, and its side in shoulder-in poses."""

import json
import sys

from validation import backlash, hardstops, shoulder_in
from validation.options import campaign_parser, campaign_runner

EXAMPLE = "example: python -m validation.joints --arms 4 --repeats 50 --sequences 20 > joints.json"


def main() -> int:
    """Print the results as JSON; return 1 if a campaign is out of its bounds."""
    parser = campaign_parser("joints", __doc__, EXAMPLE)
    parser.add_argument("--arms", type=int, default=4, help="as-built arms for the hardstops (default 4)")
    parser.add_argument("--repeats", type=int, default=50, help="repetitions (default 50)")
    parser.add_argument("--sequences", type=int, default=20, help="sequences of 50 poses (default 20)")
    options = parser.parse_args()
    if min(options.arms, options.sequences) < 1 or options.repeats < 2 or options.seed < 0:
        parser.error("arms and sequences are 1 or more, repeats 2 or more, the seed is not negative")
    run = campaign_runner(options)
    document = {
        "hardstops": hardstops.campaign(options.arms, options.repeats, options.seed, run),
        "backlash": backlash.campaign("nominal", options.sequences, 50, options.seed, run),
        "shoulder_in": shoulder_in.document(shoulder_in.predictions(options.seed, run)),
    }
    print(json.dumps(document, indent=2))
    return 0 if all(part["in_bounds"] for part in document.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
