"""Campaigns that run other programs: all campaigns in brief, mutants, examples, interrupted commands.

Interruptions: Ctrl-C at several moments of every long command. Each command starts in its own process group,
as a shell starts it, and the whole group is interrupted after a time. Measured are the time until the command
has ended, its status, what it says, and what it leaves behind. A command that ends before the signal counts
as too late. A log must say that it is interrupted.
"""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from threading import Timer
from typing import Final

import numpy as np

from marsarm.telemetry.errors import LogError
from marsarm.telemetry.read import read_log
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
    output: str

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
            document["in_bounds"] = document.get("in_bounds", True) and not ended.failed
            if ended.failed:
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


def examples(context: Context) -> Document:
    """Run all scripts in a folder that is deleted, and keep their pictures."""
    scripts = sorted((ROOT / "examples").glob("*.py"))
    failed = []
    with TemporaryDirectory() as folder:
        for number, script in enumerate(scripts):
            context.progress(number, len(scripts), script.stem)
            ran = subprocess.run([sys.executable, str(script)], cwd=folder, stdout=sys.stderr, check=False)
            failed += [script.name] if ran.returncode else []
        pictures = sorted(Path(folder).glob("*.png"))
        if context.out is not None:
            context.out.mkdir(parents=True, exist_ok=True)
            for picture in pictures:
                shutil.copy(picture, context.out)
    return {"scripts": len(scripts), "pictures": len(pictures), "failed": failed, "in_bounds": not failed}


BOUND_S: Final = 2.0
PROGRAM: Final = "from marsarm.__main__ import start; start()"
SENTENCE: Final = re.compile(r"interrupted by SIG[A-Z]+ before the end[^\n]*\n")
PROGRESS: Final = re.compile(r"[^\n]*: \d+% after [^\n]*\n")
"""Line of progress, which a command prints each minute."""
LONGEST_S: Final = 60.0

COMMANDS: Final = {
    "place": "place --log run.mcap --no-picture",
    "place, movie": "place --movie run.gif --no-picture",
    "run": "run contact-science --log run.mcap",
    "hardstop": "hardstop --arm as-built:7",
    "hardstop, repeated": "hardstop --joint elbow --repeat 50 --picture elbow.png",
    "ik": "ik --batch targets.npz --out solved.npz",
    "reach": "reach --samples 1000000 --picture reach.png",
    "budget": "budget --reproduce --report budget.html",
    "monte-carlo": "monte-carlo --arms 40 --workers 2 --results arms.jsonl --report arms.html",
    "monte-carlo, one process": "monte-carlo --arms 40 --workers 1",
    "calibrate": "calibrate --arm as-built:7 --out arm7.toml --verify 10 --report calibration.html",
    "gap record": "gap record --out logs",
}
"""Long commands, by name."""
LEFT: Final = {"run.mcap", "arms.jsonl", "targets.npz", "logs", ".cache"}
"""Files that may be there after an interruption: logs, results to continue from, and inputs."""


@dataclass(frozen=True, slots=True)
class Interruption:
    """Command that was interrupted once."""

    name: str
    after_s: float
    outcome: str
    """ "in bounds", "too late" if the command had ended before the signal, or what was wrong."""
    ended_in_s: float = 0.0
    """Time from the signal to the end of the command and of all processes that hold its output."""


def interrupt(name: str, words: str, after_s: float, targets: Path) -> Interruption:
    """Start a command in a new folder, interrupt its process group, and check what it did."""
    with TemporaryDirectory() as folder:
        (Path(folder) / "targets.npz").symlink_to(targets)
        env = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(Path(folder) / ".cache")}
        process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, *shlex.split(words)], cwd=folder, env=env, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, process_group=0,
        )  # fmt: skip
        time.sleep(after_s)
        if process.poll() is not None:
            process.communicate()
            return Interruption(name, after_s, "too late")
        began_s = time.monotonic()
        os.killpg(process.pid, signal.SIGINT)
        try:
            _, errors = process.communicate(timeout=LONGEST_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return Interruption(name, after_s, f"runs on after {LONGEST_S:g} s")
        ended_in_s = time.monotonic() - began_s
        problem = find_problem(Path(folder), process.returncode, errors, ended_in_s)
        return Interruption(name, after_s, problem or "in bounds", ended_in_s)


def find_problem(folder: Path, status: int, errors: str, ended_in_s: float) -> str | None:
    """Return what is wrong with an interrupted command; None if nothing is."""
    if status == 0:
        return "too late"  # it had printed its result when the signal came
    if status != 128 + signal.SIGINT:
        return f"status {status}: {errors[-300:]}"
    if SENTENCE.fullmatch(PROGRESS.sub("", errors)) is None:
        return f"says {errors[-300:]!r}"
    if ended_in_s > BOUND_S:
        return f"ended after {ended_in_s:.1f} s"
    left = {one.name for one in folder.iterdir()} - LEFT
    if left:
        return f"left {', '.join(sorted(left))}"
    log = folder / "run.mcap"
    if log.exists():
        try:
            end = read_log(log).end
        except LogError as error:
            return f"log: {error}"
        if end != "interrupted":
            return f"log ends as {end}"
    return None


def write_targets(path: Path, count: int) -> Path:
    """Write a batch of equal targets for `ik`."""
    position, approach = np.array([2.1, 0.0, -0.3]), np.array([0.5, 0.0, 0.85])
    np.savez(path, position_m=np.tile(position, (count, 1)), approach=np.tile(approach, (count, 1)))
    return path


def summarize(found: Sequence[Interruption]) -> Document:
    """Count the interruptions; return the longest time, and those out of bounds."""
    wrong = [asdict(one) for one in found if one.outcome not in ("in bounds", "too late")]
    in_time = [one for one in found if one.outcome == "in bounds"]
    return {
        "interruptions": len(found),
        "in_time": len(in_time),
        "too_late": sum(one.outcome == "too late" for one in found),
        "wrong": wrong,
        "longest_s": max((one.ended_in_s for one in in_time), default=None),
        "bound_s": BOUND_S,
        "in_bounds": bool(in_time) and not wrong,
    }


def interruptions(context: Context, moments: str = "0.8,2,5,12,25", only: str = "") -> Document:
    """Interrupt every command at every moment; in bounds if all that came in time were right.

    Args:
        context: Told of the progress.
        moments: Times of the signal after the start [s], with commas.
        only: Names of commands, with commas; empty for all.
    """
    chosen = only.split(",") if only else list(COMMANDS)
    if unknown := set(chosen) - set(COMMANDS):
        raise BadRequest(f"set only: {', '.join(sorted(unknown))}: there are {', '.join(COMMANDS)}")
    found: list[Interruption] = []
    with TemporaryDirectory() as folder:
        targets = write_targets(Path(folder) / "targets.npz", 2_000_000)
        for name, after in product(chosen, moments.split(",")):
            found.append(interrupt(name, COMMANDS[name], float(after), targets))
            context.progress(len(found), len(chosen) * len(moments.split(",")), name)
    return summarize(found)
