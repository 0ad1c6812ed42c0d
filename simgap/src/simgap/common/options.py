"""Options of the verbs: each is declared once, at a field of a request class, and checked from there.

A field is declared as `poses: Annotated[int, Option("Number of poses.", within=(1, 100))] = 10`. The command
line makes an option of it with the default of the field; `check_options` refuses what is not allowed.
"""

import shlex
from collections.abc import Iterable, Iterator
from dataclasses import MISSING, dataclass, fields, is_dataclass
from numbers import Integral, Real
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Final, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

from simgap.common.errors import BadRequest
from simgap.common.files import check_distinct_files, check_output

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Option:
    """Option of a verb, as metadata of a field of its request."""

    help: str
    metavar: str | None = None
    name: str | None = None
    """Name on the command line; None for that of the field, `--new-params` for `new_params`."""
    is_argument: bool = False
    within: tuple[float, float | None] | None = None
    """Smallest and largest value; None for no largest one."""
    is_read: bool = False
    """True for a file that is read, so that none that is written may be the same."""
    suffixes: tuple[str, ...] = ()
    """Suffixes of a file that is written."""
    help_without: str | None = None
    """Help of the flag `--no-NAME`, which sets the field to None."""


TYPES: Final[dict[type, tuple[tuple[type, ...], str]]] = {
    float: ((Real,), "a number"),
    int: ((Integral,), "a whole number"),
    bool: ((bool,), "True or False"),
    str: ((str,), "a text"),
    Path: ((Path,), "a pathlib.Path"),
}
"""Types that a value may have, and what an error calls them, by the type of a field."""


class Field(NamedTuple):
    """Field of a request with its option, or a group of options: a field that is a request itself."""

    name: str
    type: Any
    option: Option | None
    """None for a group."""
    default: Any
    """dataclasses.MISSING if the option must be given."""

    @property
    def label(self) -> str:
        """Name of the option in errors."""
        name = None if self.option is None else self.option.name
        return (name or self.name.replace("_", "-")).removeprefix("--").partition("/")[0]

    @property
    def is_list(self) -> bool:
        """True for a tuple of any length, whose option is given once for each value."""
        return get_origin(self.type) is tuple and get_args(self.type)[1:] == (...,)


def option_fields(request_type: type) -> Iterator[Field]:
    """List the options and groups of a request class; fields that are neither are left out."""
    hints = get_type_hints(request_type, include_extras=True)
    for field in fields(request_type):
        hint = hints[field.name]
        if is_dataclass(hint):
            yield Field(field.name, hint, None, field.default)
        elif get_origin(hint) is Annotated:
            kind, option = get_args(hint)
            yield Field(field.name, kind, option, field.default)


def check_options(request: Any) -> None:
    """Check a request by the declarations of its options; BadRequest if one is wrong or two name one file."""
    given = list(_values(request))
    for field, option, value in given:
        _check_value(field, option, value)
    read = dict(file for field, option, value in given if option.is_read for file in _files(field, value))
    written = [(field.label, option, value) for field, option, value in given if option.suffixes]
    check_distinct_files(read | {label: path for label, _, path in written})
    for label, option, path in written:
        check_output(path, option.suffixes, label)


def _values(request: Any) -> Iterator[tuple[Field, Option, Any]]:
    """Yield each option with its value, except None where the type has it; refuse a value of another type."""
    for field in option_fields(type(request)):
        value = getattr(request, field.name)
        misfit = _find_misfit(field.type, value)
        if misfit is not None:
            raise BadRequest(f"{field.label}: takes {misfit}, not {value!r:.60}")
        if field.option is None:
            yield from _values(value)
        elif value is not None:
            yield field, field.option, value


def _find_misfit(kind: Any, value: Any) -> str | None:
    """Return in words what a type takes if a value is not of it; numbers may be of numpy, tuples lists."""
    if get_origin(kind) in (UnionType, Union):
        return None if value is None else _find_misfit(get_args(kind)[0], value)
    if get_origin(kind) is Literal:
        return None  # _check_value lists what there is
    if get_origin(kind) is not tuple:
        types, words = TYPES.get(kind, ((kind,), f"a {kind.__name__}"))
        return None if isinstance(value, types) and (kind is bool) is isinstance(value, bool) else words
    first, *more = get_args(kind)
    count = 1 + len(more)
    is_any_count = more == [...]
    words = f"a tuple, each item {TYPES[first][1]}" if is_any_count else f"{count} numbers"
    is_list = isinstance(value, Iterable) and not isinstance(value, str | bytes)
    items = list(value) if is_list else []
    fits = is_list and (is_any_count or len(items) == count)
    return None if fits and all(_find_misfit(first, item) is None for item in items) else words


def _files(field: Field, value: Any) -> Iterator[tuple[str, Path]]:
    """Yield the files that an option names; an effect or a scenario is a file if it ends in .toml."""
    is_one = isinstance(value, str | Path)
    for one in (value,) if is_one else value:
        label = field.label if is_one else f"{field.label} {one}"
        if isinstance(one, Path) or one.endswith(".toml"):
            yield label, Path(one)


def _check_value(field: Field, option: Option, value: Any) -> None:
    if get_origin(field.type) is Literal and value not in get_args(field.type):
        raise BadRequest(
            f"{field.label}: {value!r} is not known; there are {', '.join(get_args(field.type))}"
        )
    if option.within is None:
        return
    least, most = option.within
    if most is None and value < least:
        raise BadRequest(f"{field.label}: {_format(value)} is below {_format(least)}")
    if most is not None and not least <= value <= most:
        raise BadRequest(f"{field.label}: {_format(value)} is not within {_format(least)} .. {_format(most)}")


def _format(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:g}"


CLUSTER_HERE: Final = "auto"
"""Value of `--cluster` alone: the cluster that RAY_ADDRESS names, or else that of this machine."""
CLUSTER_HELP: Final = (
    "Run on a Ray cluster: on that at HOST:PORT, or without it on that of RAY_ADDRESS or of this machine."
)
WorkersOption = Annotated[
    int | None, Option("Number of processes; all cores if not given.", within=(1, 1000))
]
ClusterOption = Annotated[str | None, Option(CLUSTER_HELP, "HOST:PORT")]
ReportOption = Annotated[
    Path | None, Option("Write a page with tables and pictures.", "FILE.html", suffixes=(".html",))
]


def command_text(command: str, request: Any) -> str:
    """Return the command line of a request, without options that have their defaults.

    Files that are written are left out: the name of a report is not part of its content.
    """
    return shlex.join([*command.split(), *_words(request, MISSING)])


def _words(request: Any, group: Any) -> Iterator[str]:
    """Yield the words of a request; `group` holds its defaults if it is a group in another request."""
    for field in option_fields(type(request)):
        value = getattr(request, field.name)
        default = field.default if group is MISSING else getattr(group, field.name)
        if field.option is None:
            yield from _words(value, default)
        elif value != default and not field.option.suffixes:
            yield from _option_words(field, value)


def _option_words(field: Field, value: Any) -> Iterator[str]:
    assert field.option is not None
    values = value if isinstance(value, tuple) else (value,)
    name = f"--{field.label}"
    if field.option.is_argument:
        yield from map(str, values)
    elif value is None:
        yield f"--no-{field.label}"
    elif value is True:
        yield name
    elif field.is_list:
        for one in values:
            yield from (name, str(one))
    else:
        yield from (name, *map(str, values))
