"""Memory of a run without a log: `marsarm run contact-science` on the nominal arm, 50,000 cycles.

Example: python -m validation.memory
"""

import json
import os
import sys
from pathlib import Path
from typing import Any, Final

from marsarm.runs.execution import FRAME_CYCLES
from marsarm.runs.request import RunRequest
from marsarm.runs.scenario import run_scenario

FROM_CYCLE: Final = 2_000
BY_CYCLE: Final = 10_000
MOST_GROWTH_MB: Final = 20.0
"""Largest growth of the resident memory from `FROM_CYCLE` to the end of the run."""


def memory() -> dict[str, Any]:
    """Measure the resident memory by cycle, and compare its growth with the bound."""
    resident: list[tuple[str, float]] = []
    run_scenario(
        RunRequest("contact-science"), lambda _, __, activity: resident.append((activity, _resident_MB()))
    )
    begun = [activity for activity, _ in resident].index("teaching") + 1
    by_cycle = {n * FRAME_CYCLES: size_MB for n, (_, size_MB) in enumerate(resident[begun:])}
    later_MB = [size_MB for cycle, size_MB in by_cycle.items() if cycle >= FROM_CYCLE]
    growth_MB = max(later_MB) - later_MB[0]
    return {
        "resident_MB": {cycle: by_cycle[cycle] for cycle in list(by_cycle)[:: BY_CYCLE // FRAME_CYCLES]},
        "cycles": max(by_cycle),
        "growth_MB": growth_MB,
        "limit_MB": MOST_GROWTH_MB,
        "in_bounds": growth_MB <= MOST_GROWTH_MB,
    }


def _resident_MB() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


if __name__ == "__main__":
    found = memory()
    print(json.dumps(found, indent=2))
    sys.exit(0 if found["in_bounds"] else 1)
