"""Campaigns: what each shows, how long it takes, and the sizes with which it takes a minute at most.

A campaign is a function of a `Context` and of keyword arguments, its sizes. It returns a JSON document, whose
`in_bounds` says whether it succeeded.
"""

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import UnionType
from typing import Any, Final, TypeVar, get_args

from marsarm.common.pool import Runner, in_order, run_here
from simgap.common.errors import BadRequest
from simgap.common.progress import Progress, no_progress
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
    """Read NAME=VALUE by the annotations of the function of a campaign.

    Raises:
        BadRequest: A name is not known, or a value has another type.
    """
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
