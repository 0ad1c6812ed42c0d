"""Record the reference runs again: `python -m tests.replay.remake [NAME ...]`.

All differences are printed before a file is replaced. A file with an identical run is not changed.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from rich.console import Console

from marsarm.replaying.compare import Differences, compare_behaviours
from marsarm.replaying.inputs import SENSOR_TOPIC, behaviour_from_log
from marsarm.replaying.replay import difference_lines, verdict_line
from marsarm.telemetry.format import LogError
from marsarm.telemetry.read import read_log
from marsarm.telemetry.recorder import Recorder, run_header
from tests.replay.runs import RUNS, ReferenceRun

FOLDER = Path(__file__).parent
ONE_CHUNK = 1 << 30
STARTS_WITH = ("params", "boot", "commands", "mjcf_sha256", "cpu")


def path_of(run: ReferenceRun, folder: Path = FOLDER) -> Path:
    return folder / f"{run.name}.mcap"


def make(run: ReferenceRun, folder: Path) -> Path:
    """Carry out a run, and write its log."""
    loop, path = run.loop(), path_of(run, folder)
    header = run_header(
        loop, run.arm, run.seed, {"reference": run.name}, [command for command, _ in run.asks]
    )
    with Recorder(path, header, chunk_cycles=ONE_CHUNK) as recorder:
        for record in run.cycles(loop):
            recorder.write(record)
    return path


def between(old: Path, new: Path) -> Differences:
    """Compare the outputs of the old and the new log of a run."""
    logs = read_log(old), read_log(new)
    behaviours = [behaviour_from_log(log, len(log[SENSOR_TOPIC])) for log in logs]
    return compare_behaviours(*behaviours)


def stale(old: Path, new: Path) -> list[str]:
    """List the keys of inputs and processor in which the headers of the old and the new log differ."""
    was, now = read_log(old).header, read_log(new).header
    return [key for key in STARTS_WITH if was.get(key) != now.get(key)]


def remake(run: ReferenceRun, console: Console) -> None:
    """Record a run again, print the differences from the old file, and replace it if there are any."""
    old = path_of(run)
    with TemporaryDirectory(dir=FOLDER) as folder:
        new = make(run, Path(folder))
        try:
            differs = not old.exists() or tell(run, old, new, console)
        except LogError as error:
            console.print(f"{run.name}: cannot be read any more: {error}", markup=False, soft_wrap=True)
            differs = True
        if differs:
            new.replace(old)
            console.print(f"{run.name}: made, {old.stat().st_size} bytes")


def tell(run: ReferenceRun, old: Path, new: Path, console: Console) -> bool:
    """Print the differences, and return whether there are any."""
    found, headers = between(old, new), stale(old, new)
    console.print(f"{run.name}: {verdict_line(found)}", soft_wrap=True)
    if not found.identical:
        console.print("recorded is what the file held, replayed the run made anew")
        for line in difference_lines(found):
            console.print(line, markup=False, soft_wrap=True)
    if headers:
        console.print(f"header    has another {', '.join(headers)}")
    return bool(headers) or not found.identical


def main(names: Sequence[str]) -> None:
    """Record these runs again, or all."""
    known = [run.name for run in RUNS]
    unknown = [name for name in names if name not in known]
    if unknown:
        sys.exit(f"{', '.join(unknown)}: no such run; there are {', '.join(known)}")
    console = Console(highlight=False)
    for run in RUNS:
        if not names or run.name in names:
            remake(run, console)


if __name__ == "__main__":
    main(sys.argv[1:])
