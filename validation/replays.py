"""Campaign of replays: every scenario on several arms is recorded and replayed with equal outputs.

Each run has its own arm, tilt and seed, and the log is read back from its file. The rate of the replay is
relative to real time, and to the run that it replays.
"""

import json
import sys
import time
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

from fsw.config import CYCLE_HZ
from marsarm.common.pool import Runner, in_order
from marsarm.replay.replay import ReplayRequest, replay
from marsarm.replay.tables import verdict_line
from marsarm.runs.request import RunFiles, RunRequest
from marsarm.runs.scenario import run_scenario
from sim.scenario.file import built_in_scenarios
from simgap.common.errors import BadRequest
from validation.options import campaign_parser, campaign_runner

TILT_DEG = (6.0, -4.0)
"""Roll and pitch of the rover, with arms other than the nominal one."""
NOT_REPLAYED = "not replayed"
"""Outcome of a run that was refused, or whose log was refused; it counts as not identical."""


@dataclass(frozen=True, slots=True)
class ReplayOutcome:
    """Scenario on an arm and its replay."""

    scenario: str
    arm: str
    outcome: str
    verdict: str
    identical: bool
    ticks: int
    log_bytes: int
    times_real_time: float
    times_the_run: float


def silent(*_: object) -> None:
    """Ignore progress."""


def replay_one(scenario: str, arm: str) -> ReplayOutcome:
    """Run a scenario on an arm, record it, and replay its log."""
    with TemporaryDirectory() as folder:
        log = Path(folder) / "run.mcap"
        seed = int(arm.partition(":")[2] or 0)
        tilt_deg = None if arm == "nominal" else TILT_DEG
        try:
            ran = run_scenario(RunRequest(scenario, arm, tilt_deg, seed, files=RunFiles(log)), silent)
            began = time.perf_counter()
            found = replay(ReplayRequest(log), silent).differences
        except BadRequest as error:
            return ReplayOutcome(scenario, arm, NOT_REPLAYED, str(error), False, 0, 0, 0.0, 0.0)
        rate = found.ticks[0] / CYCLE_HZ / (time.perf_counter() - began)
        return ReplayOutcome(
            scenario=scenario,
            arm=arm,
            outcome=str(ran.execution.result.outcome),
            verdict=verdict_line(found),
            identical=found.identical and found.tolerance == 0.0,
            ticks=found.ticks[0],
            log_bytes=log.stat().st_size,
            times_real_time=rate,
            times_the_run=rate / ran.execution.realtime_factor,
        )


def document(arms: int, seed: int, runner: Runner, only: str | None = None) -> dict[str, object]:
    """Replay every scenario, or only one, on the nominal arm and on this many of each other kind."""
    names = ["nominal", *(f"{k}:{seed + n}" for n in range(1, arms + 1) for k in ("calibrated", "as-built"))]
    jobs = list(product([only] if only else built_in_scenarios(), names))
    ran: list[ReplayOutcome] = []
    for k, found in enumerate(in_order(runner, replay_one, jobs), start=1):
        ran.append(found)
        print(f"\rreplays: {k} of {len(jobs)}", end="", file=sys.stderr)
    print(file=sys.stderr)
    return summarize(ran)


def summarize(ran: list[ReplayOutcome]) -> dict[str, object]:
    """Return the JSON document of the requested runs."""
    return {
        "requested": len(ran),
        "replayed": sum(r.outcome != NOT_REPLAYED for r in ran),
        "identical": sum(r.identical for r in ran),
        "ticks": sum(r.ticks for r in ran),
        "runs": [asdict(r) for r in ran],
    }


def main() -> None:
    """Print the result as JSON; exit with 1 if a replay is not identical."""
    parser = campaign_parser("replays", __doc__, "example: python -m validation.replays --arms 1")
    parser.add_argument("--arms", type=int, default=3, help="arms of each kind but nominal (default 3)")
    parser.add_argument("--only", choices=list(built_in_scenarios()), help="one scenario, in place of all")
    options = parser.parse_args()
    found = document(options.arms, options.seed, campaign_runner(options), options.only)
    print(json.dumps(found, indent=2))
    sys.exit(found["identical"] != found["requested"])


if __name__ == "__main__":
    main()
