"""Campaigns that run other programs: all campaigns in brief, and mutants of fsw/protect."""

import os
import shutil
import subprocess
import sys
from collections import Counter
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
    output: str

    def line(self) -> str:
        """Format the verdict as a line of text."""
        verdict = f"FAILED, exit status {self.status}" if self.status else "in bounds"
        return f"{self.campaign.name:<14} {self.core_s:4.0f} s, {verdict}"


def run_brief(campaign: Campaign, seed: int) -> BriefResult:
    """Run a campaign in a separate process."""
    command = [sys.executable, "-m", "validation", campaign.name, "--brief", "--workers", "1"]
    with TemporaryFile() as file:
        streams = tuple((os.POSIX_SPAWN_DUP2, file.fileno(), stream) for stream in (1, 2))
        command += ["--seed", str(seed)]
        process = os.posix_spawn(sys.executable, command, os.environ, file_actions=streams, setpgroup=0)
        timeout = Timer(TIMEOUT_S, os.killpg, (process, 9))
        timeout.start()
        _, status, usage = os.wait4(process, 0)
        timeout.cancel()
        file.seek(0)
        output = file.read().decode(errors="replace")
    return BriefResult(campaign, os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime, output)


def brief(context: Context, only: str = "") -> Document:
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
        for done, ended in enumerate(pool.map(partial(run_brief, seed=context.seed), chosen), 1):
            context.progress(done, len(chosen), ended.campaign.name)
            print(ended.line(), file=sys.stderr, flush=True)
            document[ended.campaign.name] = ended.line().partition(" ")[2].strip()
            document["in_bounds"] = document.get("in_bounds", True) and ended.status == 0
            if ended.status:
                print(ended.output, file=sys.stderr, flush=True)
    return document


LEAST_KILLED: Final = 0.95
KILLED: Final = ("killed", "timeout")
"""What mutmut calls a mutant that the tests notice."""


def mutants(context: Context) -> Document:
    """Change fsw/protect in a thousand places, one at a time; count the changes that its tests notice."""
    program = Path(sys.executable).with_name("mutmut")
    if not program.exists():
        raise BadRequest("mutmut is not installed; pip install 'mutmut>=3.8'")
    shutil.rmtree(ROOT / "mutants", ignore_errors=True)
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    words = [str(program), "run", "--max-children", str(context.workers)]
    subprocess.run(words, cwd=ROOT, env=environment, stdout=sys.stderr, check=False)
    listed = subprocess.run(
        [str(program), "results", "--all", "true"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    # fsw.protect.monitors.x_check__mutmut_3: killed
    rows = [line.strip().rpartition(": ") for line in listed.stdout.splitlines() if ": " in line]
    every = Counter(name.split(".")[2] for name, _, _ in rows)
    killed = Counter(name.split(".")[2] for name, _, end in rows if end in KILLED)
    return {
        "files": {f"{name}.py": f"{killed[name]}/{count}" for name, count in sorted(every.items())},
        "killed": killed.total(),
        "of": every.total(),
        "alive": [f"{name}: {end}" for name, _, end in rows if end not in KILLED],
        "in_bounds": killed.total() >= LEAST_KILLED * every.total() > 0.0,
    }
