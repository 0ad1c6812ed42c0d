"""Campaigns: what each shows, how long it takes, and the sizes with which it takes a minute at most.

A campaign is a function of a `Context` and of keyword arguments, its sizes. It returns a JSON document, whose
`in_bounds` says whether it succeeded. `brief` and `mutants` run other programs.
"""

import inspect
import os
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryFile
from threading import Timer
from types import UnionType
from typing import Any, Final, TypeVar, get_args

from marsarm.common.pool import Runner, in_order, run_here
from simgap.common.errors import BadRequest
from simgap.common.progress import GUESS, Progress, no_progress
from simgap.common.toml import read_toml

Document = dict[str, Any]
Sizes = Mapping[str, Any]
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Context:
    """Seed, workers, output and progress, which all campaigns are given."""

    seed: int = 0
    """Seed of everything random."""
    run: Runner = run_here
    out: Path | None = None
    """File or folder of results, of a campaign with `keeps`."""
    progress: Progress = no_progress
    workers: int = 1
    """Number of processes of `run`."""
    cluster: str | None = None
    """Address of the cluster of `run`."""

    def each(
        self, work: Callable[..., Result], jobs: Iterable[tuple[Any, ...]], what: str = "done"
    ) -> list[Result]:
        """Return `work(*job)` of each job in the order of the jobs, and tell the progress."""
        every, found = list(jobs), list[Result]()
        self.progress(0, len(every), what)
        for one in in_order(self.run, work, every):
            found.append(one)
            self.progress(len(found), len(every), what)
        return found


@dataclass(frozen=True, slots=True)
class Campaign:
    """Row of the table of campaigns."""

    name: str
    shows: str
    takes: str
    """Time on two cores."""
    brief: Sizes | None = None
    """Sizes with which it takes a minute at most; None for a campaign without a brief form."""
    keeps: str = ""
    """What the file or folder of `--out` holds; empty if it is the document."""
    needs: str = ""
    """Requirement that a machine may lack."""
    place: str = ""
    """Function, as module:function of this package; `campaign` of the module of its name if empty."""

    def load(self) -> Callable[..., Document]:
        """Import the function of the campaign."""
        module, _, function = (self.place or self.name).partition(":")
        found = import_module(f"validation.{module.replace('-', '_')}")
        work: Callable[..., Document] = getattr(found, function or "campaign")
        return work


def load_table() -> tuple[Campaign, ...]:
    """Read campaigns.toml."""
    document = read_toml(Path(__file__).with_suffix(".toml"))
    return tuple(Campaign(name, **fields) for name, fields in document.items())


TABLE: Final = load_table()


def find_campaign(name: str) -> Campaign:
    """Return the campaign of a name; BadRequest if there is none."""
    for one in TABLE:
        if one.name == name:
            return one
    raise BadRequest(f"{name}: is no campaign; `python -m validation` lists them")


def read_sizes(work: Callable[..., Any], words: Iterable[str]) -> dict[str, Any]:
    """Read NAME=VALUE as the function of a campaign annotates it; BadRequest for another name or type."""
    known = dict(list(inspect.signature(work).parameters.items())[1:])
    sizes = {}
    for word in words:
        name, _, value = word.partition("=")
        if name not in known:
            raise BadRequest(f"set {name}: is not known; there are {', '.join(known) or 'none'}")
        sizes[name] = _read_value(name, value, known[name].annotation)
    missing = [n for n, one in known.items() if one.default is inspect.Parameter.empty and n not in sizes]
    if missing:
        raise BadRequest(f"set {missing[0]}: is missing")
    return sizes


def _read_value(name: str, value: str, kind: Any) -> Any:
    types = get_args(kind) if isinstance(kind, UnionType) else (kind,)
    try:
        if bool in types:
            return {"true": True, "false": False}[value.lower()]
        number = next((one(value) for one in (int, float) if one in types), None)
    except (KeyError, ValueError) as error:
        raise BadRequest(f"set {name}: {value!r} is not {types[0].__name__}") from error
    if number is not None and number < 0:
        raise BadRequest(f"set {name}: {value} is below 0")
    return number if number is not None else Path(value) if Path in types else value


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
    """Run all campaigns, or those named, with commas, as many at a time as there are workers."""
    chosen = [one for one in TABLE if one.brief is not None and (not only or one.name in only.split(","))]
    if not chosen:
        raise BadRequest(f"set only: no campaign with a brief form is called {only}")
    os.chdir(ROOT)
    document: Document = {}
    context.progress(0, GUESS, chosen[0].name)  # a share in the first report would be an earlier result
    with ThreadPoolExecutor(context.workers) as pool:
        for done, ended in enumerate(pool.map(partial(run_brief, seed=context.seed), chosen), 1):
            context.progress(done / len(chosen), GUESS, ended.campaign.name)
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
    words = [str(program), "results", "--all", "true"]
    listed = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
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
