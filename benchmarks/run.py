"""All benchmarks that fit in two minutes, as one JSON document on standard output."""

import json
import platform

from benchmarks.closed_loop import closed_loop
from benchmarks.kinematics import campaign
from benchmarks.kinematics_speed import kinematics_speed
from benchmarks.log_reading import log_reading
from benchmarks.recording import recording

CAMPAIGN = 20_000
"""Targets, and as many vectors; `make campaign` runs ten million of each."""


def main() -> None:
    """Measure and print."""
    machine = {"python": platform.python_version(), "machine": platform.machine()}
    results = {
        "machine": machine,
        "closed_loop": closed_loop(),
        "recording": recording(),
        "kinematics_speed": kinematics_speed(),
        "log_reading": log_reading(),
        "kinematics_campaign": campaign(CAMPAIGN, CAMPAIGN),
    }
    print(json.dumps(results, indent=2))


if __name__ == "__main__":
    main()
