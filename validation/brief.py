"""Brief runs of all campaigns, two at a time, each in a minute of one core at most.

Each campaign prints a line with its verdict and its processor time. The exit status is 1 if a campaign fails;
its standard error is then printed. The fuzz campaign, `make fuzz`, always takes a minute and is not included.
"""

import os
import shlex
import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryFile
from threading import Timer
from typing import Final

ROOT: Final = Path(__file__).parents[1]
SKIPPED: Final = 2
"""Exit status of a campaign with a missing requirement, and of one with wrong arguments."""
TIMEOUT_S: Final = 600.0
"""Time after which a campaign of a minute is killed; the machine may be busy."""


@dataclass(frozen=True, slots=True)
class Brief:
    """Campaign, and the arguments with which it takes a minute at most."""

    name: str
    arguments: str
    needs: str = ""
    """Requirement that a machine may lack; the campaign then exits with SKIPPED."""


BRIEFS: Final = (
    Brief("monte_carlo", "--statics 100 --closed-loop 10 --calibrated 0 --workers 1"),
    Brief("blind.brief", ""),
    Brief("robot_cases.brief", "--seed 1"),
    Brief("robot_cost", "--settings 1"),
    Brief("faults", "--count 2 --only processing --workers 1"),
    Brief("tool_change", "--calibrated 1 --as-built 0 --poses 1 --workers 1"),
    Brief("scenarios", "--calibrated 0 --as-built 0 --only processing --workers 1"),
    Brief("contact", "--arms 1 --workers 1"),
    Brief("obstacles", "--count 4 --seed 1 --workers 1"),
    Brief("replays", "--arms 0 --only processing --workers 1"),
    Brief("shoulder_in", "--groups 1 --poses 3 --workers 1"),
    Brief("backlash", "--sequences 1 --poses 5 --workers 1"),
    Brief("hardstops", "--arms 1 --repeats 2 --joint ELBOW --workers 1"),
    Brief("calibration", "--arms 1 --without-speed --workers 1"),
    Brief("kinematics", "--targets 4000 --vectors 4000 --workers 1"),
    Brief("commands", "--cycles 10000 --workers 1"),
    Brief("damage", "--tries 50 --cycles 128"),
    Brief("killed", "--kills 3"),
    Brief("interrupt", "--moments 3 --only ik --only reach --only monte-carlo --only 'gap record'"),
    Brief("robot_controls", "--only shuffled"),
    Brief("ur10", "", needs="MARSARM_DATA, a folder with the measured poses"),
    Brief("oracle", "--targets 2000", needs="EAIK"),
)
"""Campaigns, the longest first, so that two cores finish at about the same time."""


@dataclass(frozen=True, slots=True)
class BriefResult:
    """Campaign that has ended."""

    brief: Brief
    status: int
    """Exit status."""
    core_s: float
    """Processor time."""
    stderr: str

    @property
    def skipped(self) -> bool:
        """True if the machine lacks a requirement of the campaign."""
        return bool(self.brief.needs) and self.status == SKIPPED

    @property
    def failed(self) -> bool:
        """True if the campaign is out of its bounds, or crashed."""
        return self.status != 0 and not self.skipped

    def line(self) -> str:
        """Format the verdict as a line of text."""
        verdict = "FAILED" if self.failed else "skipped" if self.skipped else "in bounds"
        needs = f", needs {self.brief.needs}" if self.skipped else ""
        status = f", exit status {self.status}" if self.failed else ""
        return f"{self.brief.name:<12} {verdict:<9} {self.core_s:4.0f} s{needs}{status}"


def run(brief: Brief) -> BriefResult:
    """Run a campaign in a separate process."""
    command = [sys.executable, "-m", f"validation.{brief.name}", *shlex.split(brief.arguments)]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    with TemporaryFile() as file:
        streams = (
            (os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0),
            (os.POSIX_SPAWN_DUP2, file.fileno(), 2),
        )
        process = os.posix_spawn(sys.executable, command, environment, file_actions=streams, setpgroup=0)
        timeout = Timer(TIMEOUT_S, os.killpg, (process, 9))
        timeout.start()
        _, status, usage = os.wait4(process, 0)
        timeout.cancel()
        file.seek(0)
        lines = file.read().decode(errors="replace").split("\n")
    stderr = "\n".join(line.rpartition("\r")[2] for line in lines)  # progress overwrites its line
    return BriefResult(brief, os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime, stderr)


def main(briefs: Sequence[Brief] = BRIEFS) -> int:
    """Run the campaigns and print a line for each; return 1 if one failed."""
    parser = ArgumentParser("python -m validation.brief", description=__doc__)
    parser.formatter_class = RawDescriptionHelpFormatter
    names = [brief.name for brief in briefs]
    parser.add_argument("--workers", type=int, default=2, help="campaigns at a time (default 2)")
    parser.add_argument("--only", choices=names, action="append", help="run only this campaign; repeatable")
    options = parser.parse_args()
    os.chdir(ROOT)
    wanted = [brief for brief in briefs if brief.name in (options.only or names)]
    failed = 0
    with ThreadPoolExecutor(options.workers) as pool:
        for ended in pool.map(run, wanted):
            print(ended.line(), flush=True)
            if ended.failed:
                failed += 1
                print(ended.stderr, file=sys.stderr, flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
