"""Every campaign in brief, two at a time: each in a minute or less of one core, each in its bounds or not.

A line says what became of a campaign and what it took of a core. Exit status 1 if one is out of its bounds or
broken; its standard error is then shown. The fuzz campaign takes a minute as it is: `make fuzz`.
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
"""Exit status of a campaign that lacks what it needs, and of one that does not know its arguments."""
HANGS_S: Final = 600.0
"""After which a campaign of a minute is taken to hang, on a machine that does other things."""


@dataclass(frozen=True, slots=True)
class Brief:
    """A campaign, and the arguments with which it takes a minute at most."""

    name: str
    arguments: str
    needs: str = ""
    """What a machine may lack; the campaign is then skipped, which it says by its exit status."""


BRIEFS: Final = (
    Brief("monte_carlo", "--statics 100 --closed-loop 10 --calibrated 0 --workers 1"),
    Brief("blind.brief", ""),
    Brief("faults", "--count 2 --only processing --workers 1"),
    Brief("tool_change", "--calibrated 1 --as-built 0 --poses 1 --workers 1"),
    Brief("scenarios", "--calibrated 0 --as-built 0 --only processing --workers 1"),
    Brief("contact", "--arms 1 --workers 1"),
    Brief("replays", "--arms 0 --only processing --workers 1"),
    Brief("shoulder_in", "--groups 1 --poses 3 --workers 1"),
    Brief("backlash", "--tours 1 --poses 5 --workers 1"),
    Brief("hardstops", "--arms 1 --repeats 2 --joint ELBOW --workers 1"),
    Brief("calibration", "--arms 1 --without-speed --workers 1"),
    Brief("kinematics", "--targets 4000 --vectors 4000 --workers 1"),
    Brief("damage", "--tries 50 --cycles 128"),
    Brief("killed", "--kills 3"),
    Brief("ur10", "", needs="MARSARM_DATA, a folder with the measured poses"),
    Brief("oracle", "--targets 2000", needs="EAIK"),
)
"""The longest first, so that two cores are done at about the same time."""


@dataclass(frozen=True, slots=True)
class BriefResult:
    """What became of a campaign."""

    brief: Brief
    status: int
    core_s: float
    said: str

    @property
    def skipped(self) -> bool:
        """Whether it lacked what it needs."""
        return bool(self.brief.needs) and self.status == SKIPPED

    @property
    def failed(self) -> bool:
        """Whether it is out of its bounds, or broken."""
        return self.status != 0 and not self.skipped

    def line(self) -> str:
        """A line about it."""
        verdict = "FAILED" if self.failed else "skipped" if self.skipped else "in bounds"
        why = f", needs {self.brief.needs}" if self.skipped else ""
        how = f", exit status {self.status}" if self.failed else ""
        return f"{self.brief.name:<12} {verdict:<9} {self.core_s:4.0f} s{why}{how}"


def run(brief: Brief) -> BriefResult:
    """Carry it out in a process of its own."""
    command = [sys.executable, "-m", f"validation.{brief.name}", *shlex.split(brief.arguments)]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    with TemporaryFile() as said:
        streams = (
            (os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0),
            (os.POSIX_SPAWN_DUP2, said.fileno(), 2),
        )
        process = os.posix_spawn(sys.executable, command, environment, file_actions=streams, setpgroup=0)
        hangs = Timer(HANGS_S, os.killpg, (process, 9))
        hangs.start()
        _, status, spent = os.wait4(process, 0)
        hangs.cancel()
        said.seek(0)
        lines = said.read().decode(errors="replace").split("\n")
    words = "\n".join(line.rpartition("\r")[2] for line in lines)  # progress overwrites itself
    return BriefResult(brief, os.waitstatus_to_exitcode(status), spent.ru_utime + spent.ru_stime, words)


def main(briefs: Sequence[Brief] = BRIEFS) -> int:
    """Print a line for each; exit status 1 if one failed."""
    options = ArgumentParser("python -m validation.brief", description=__doc__)
    options.formatter_class = RawDescriptionHelpFormatter
    names = [brief.name for brief in briefs]
    options.add_argument("--workers", type=int, default=2, help="at a time (default 2)")
    options.add_argument("--only", choices=names, action="append", help="one of them; again for more")
    asked = options.parse_args()
    os.chdir(ROOT)
    wanted = [brief for brief in briefs if brief.name in (asked.only or names)]
    failed = 0
    with ThreadPoolExecutor(asked.workers) as pool:
        for ended in pool.map(run, wanted):
            print(ended.line(), flush=True)
            if ended.failed:
                failed += 1
                print(ended.said, file=sys.stderr, flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
