"""Campaign of interrupted commands: Ctrl-C at several moments of every long command.

Each command starts in its own process group, as a shell starts it, and the whole group is interrupted after a
time. Measured are the time until the command has ended, its status, what it says, and what it leaves behind.
A command that ends before the signal counts as too late. A log must say that it is interrupted.

Example: python -m validation.interrupt --moments 2 10
"""

import argparse
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from marsarm.telemetry.errors import LogError
from marsarm.telemetry.read import read_log

BOUND_S: Final = 2.0
ROOT: Final = Path(__file__).parents[1]
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
OF_A_LOG: Final = {
    "replay": "replay long.mcap",
    "log export": "log export long.mcap tables --csv",
    "log recover": "log recover long.mcap saved.mcap",
}
"""Commands that need the log of `--long-log`."""
OF_A_CAMPAIGN: Final = {"diagnose": "diagnose logs --report gap.html --patch found.toml"}
"""Commands that need the logs of `--campaign`."""
LEFT: Final = {"run.mcap", "arms.jsonl", "long.mcap", "targets.npz", "logs", ".cache"}
"""Files that may be there after an interruption: logs, results to continue from, and inputs."""


@dataclass(frozen=True, slots=True)
class Interruption:
    """Command that was interrupted once."""

    name: str
    signal: str
    after_s: float
    outcome: str
    """ "in bounds", "too late" if the command had ended before the signal, or what was wrong."""
    ended_in_s: float = 0.0
    """Time from the signal to the end of the command and of all processes that hold its output."""


@dataclass(frozen=True, slots=True)
class Inputs:
    """Files that commands read."""

    targets: Path
    long_log: Path | None
    campaign: Path | None

    def put_into(self, folder: Path) -> None:
        """Link the inputs into the folder of a command."""
        (folder / "targets.npz").symlink_to(self.targets)
        if self.long_log is not None:
            (folder / "long.mcap").symlink_to(self.long_log.resolve())
        if self.campaign is not None:
            (folder / "logs").symlink_to(self.campaign.resolve())


def interrupt(name: str, words: str, number: signal.Signals, after_s: float, inputs: Inputs) -> Interruption:
    """Start a command in a new folder, interrupt its process group, and check what it did."""
    with TemporaryDirectory() as folder:
        inputs.put_into(Path(folder))
        env = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(Path(folder) / ".cache")}
        process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, *shlex.split(words)], cwd=folder, env=env, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, process_group=0,
        )  # fmt: skip
        time.sleep(after_s)
        if process.poll() is not None:
            process.communicate()
            return Interruption(name, number.name, after_s, "too late")
        began_s = time.monotonic()
        os.killpg(process.pid, number)
        try:
            _, errors = process.communicate(timeout=LONGEST_S)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return Interruption(name, number.name, after_s, f"runs on after {LONGEST_S:g} s")
        ended_in_s = time.monotonic() - began_s
        problem = find_problem(Path(folder), process.returncode, errors, number, ended_in_s)
        return Interruption(name, number.name, after_s, problem or "in bounds", ended_in_s)


def find_problem(
    folder: Path, status: int, errors: str, number: signal.Signals, ended_in_s: float
) -> str | None:
    """Return what is wrong with an interrupted command; None if nothing is."""
    if status == 0:
        return "too late"  # it had printed its result when the signal came
    if status != 128 + number:
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
    import numpy as np

    position, approach = np.array([2.1, 0.0, -0.3]), np.array([0.5, 0.0, 0.85])
    np.savez(path, position_m=np.tile(position, (count, 1)), approach=np.tile(approach, (count, 1)))
    return path


def summarize(found: Sequence[Interruption]) -> dict[str, Any]:
    """Return all interruptions, the longest time, and those out of bounds, as a JSON document."""
    wrong = [asdict(one) for one in found if one.outcome not in ("in bounds", "too late")]
    in_time = [one for one in found if one.outcome == "in bounds"]
    return {
        "interruptions": len(found),
        "in_bounds": len(in_time),
        "too_late": sum(one.outcome == "too late" for one in found),
        "wrong": wrong,
        "longest_s": max((one.ended_in_s for one in in_time), default=None),
        "longest_by_command": {
            name: max((one.ended_in_s for one in in_time if one.name == name), default=None)
            for name in dict.fromkeys(one.name for one in found)
        },
        "bound_s": BOUND_S,
        "load_average": os.getloadavg()[0],
    }


def main() -> None:
    """Print the result as JSON; exit with 1 if an interruption is out of bounds, or all came too late."""
    parser = argparse.ArgumentParser(prog="python -m validation.interrupt", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument(
        "--moments", type=float, nargs="+", default=[0.8, 2.0, 5.0, 12.0, 25.0], metavar="S",
        help="times of the signal after the start (default 0.8 2 5 12 25)",
    )  # fmt: skip
    parser.add_argument("--only", action="append", help="interrupt only this command; repeatable")
    parser.add_argument("--signal", choices=("SIGINT", "SIGTERM"), default="SIGINT", help="default SIGINT")
    parser.add_argument("--long-log", type=Path, help="log for replay, export and recovery")
    parser.add_argument("--campaign", type=Path, help="folder of logs for diagnose")
    options = parser.parse_args()
    # A shell that starts a job in the background ignores SIGINT for it; commands inherit that.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    commands = COMMANDS | (OF_A_LOG if options.long_log else {}) | (OF_A_CAMPAIGN if options.campaign else {})
    unknown = set(options.only or ()) - set(commands)
    if unknown:
        parser.error(f"--only: {', '.join(sorted(unknown))} is not known; there are {', '.join(commands)}")
    found: list[Interruption] = []
    with TemporaryDirectory() as folder:
        inputs = Inputs(
            write_targets(Path(folder) / "targets.npz", 2_000_000), options.long_log, options.campaign
        )
        for name in options.only or commands:
            for after_s in options.moments:
                number = signal.Signals[options.signal]
                found.append(interrupt(name, commands[name], number, after_s, inputs))
                print(f"{name} after {after_s:g} s: {found[-1].outcome}", file=sys.stderr)
    summary = summarize(found)
    print(json.dumps(summary, indent=2))
    sys.exit(1 if summary["wrong"] or not summary["in_bounds"] else 0)


if __name__ == "__main__":
    main()
