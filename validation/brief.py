"""Brief runs of all campaigns, some at a time, each in a process of its own; a line with verdict and time."""

import os
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryFile
from threading import Timer
from typing import Final

from simgap.common.errors import BadRequest
from validation.campaigns import TABLE, Campaign, Context, Document

ROOT: Final = Path(__file__).parents[1]
SKIPPED: Final = 2
"""Exit status of a campaign with a missing requirement, and of one with wrong arguments."""
TIMEOUT_S: Final = 600.0
"""Time after which a campaign of a minute is killed; the machine may be busy."""


@dataclass(frozen=True, slots=True)
class BriefResult:
    """Campaign that has ended."""

    campaign: Campaign
    status: int
    """Exit status."""
    core_s: float
    """Processor time."""
    stderr: str

    @property
    def skipped(self) -> bool:
        """True if the machine lacks a requirement of the campaign."""
        return bool(self.campaign.needs) and self.status == SKIPPED

    @property
    def failed(self) -> bool:
        """True if the campaign is out of its bounds, or crashed."""
        return self.status != 0 and not self.skipped

    def line(self) -> str:
        """Format the verdict as a line of text."""
        verdict = "FAILED" if self.failed else "skipped" if self.skipped else "in bounds"
        needs = f", needs {self.campaign.needs}" if self.skipped else ""
        status = f", exit status {self.status}" if self.failed else ""
        return f"{self.campaign.name:<14} {verdict:<9} {self.core_s:4.0f} s{needs}{status}"


def run(campaign: Campaign, seed: int) -> BriefResult:
    """Run a campaign in a separate process."""
    command = [sys.executable, "-m", "validation", campaign.name, "--brief", "--workers", "1"]
    with TemporaryFile() as file:
        streams = (
            (os.POSIX_SPAWN_OPEN, 1, os.devnull, os.O_WRONLY, 0),
            (os.POSIX_SPAWN_DUP2, file.fileno(), 2),
        )
        command += ["--seed", str(seed)]
        process = os.posix_spawn(sys.executable, command, os.environ, file_actions=streams, setpgroup=0)
        timeout = Timer(TIMEOUT_S, os.killpg, (process, 9))
        timeout.start()
        _, status, usage = os.wait4(process, 0)
        timeout.cancel()
        file.seek(0)
        stderr = file.read().decode(errors="replace")
    return BriefResult(campaign, os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime, stderr)


def campaign(context: Context, only: str = "") -> Document:
    """Run the campaigns, as many at a time as there are workers.

    Args:
        context: Gives seed and workers.
        only: Names, with commas; empty for all.
    """
    chosen = [one for one in TABLE if one.brief is not None and (not only or one.name in only.split(","))]
    if not chosen:
        raise BadRequest(f"set only: no campaign with a brief form is called {only}")
    os.chdir(ROOT)
    document: Document = {}
    with ThreadPoolExecutor(context.workers) as pool:
        for ended in pool.map(partial(run, seed=context.seed), chosen):
            print(ended.line(), file=sys.stderr, flush=True)
            document[ended.campaign.name] = ended.line().partition(" ")[2].strip()
            document["in_bounds"] = document.get("in_bounds", True) and not ended.failed
            if ended.failed:
                print(ended.stderr, file=sys.stderr, flush=True)
    return document
