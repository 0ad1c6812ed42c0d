"""All benchmarks that fit in two minutes, as one JSON document on standard output."""

import json
import platform
import sys
from typing import Any

from validation.budget import budget_speed
from validation.closed_loop import closed_loop
from validation.kinematics import campaign
from validation.kinematics_speed import kinematics_speed
from validation.log_reading import log_reading
from validation.recording import recording

CAMPAIGN = 20_000
"""Targets, and as many vectors; `make campaign` runs ten million of each."""


def main() -> None:
    """Measure and print; exit status 1 if something is out of the bounds that it has."""
    machine = {"python": platform.python_version(), "machine": platform.machine()}
    results: dict[str, dict[str, Any]] = {
        "machine": machine,
        "closed_loop": closed_loop(),
        "recording": recording(),
        "kinematics_speed": kinematics_speed(),
        "log_reading": log_reading(),
        "budget": budget_speed(),
        "kinematics_campaign": campaign(CAMPAIGN, CAMPAIGN),
    }
    print(json.dumps(results, indent=2))
    out = [name for name, found in results.items() if not found.get("in_bounds", True)]
    if out:
        sys.exit(f"out of bounds: {', '.join(out)}")


if __name__ == "__main__":
    main()
