"""Verbs: functions whose options come from request classes, and whose results and errors are printed here."""

import inspect
import json
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, is_dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Protocol, get_args, get_origin

import typer

from simgap.common.app import EXIT_BAD_INPUT, release_stdout
from simgap.common.errors import UserError, describe_problems
from simgap.common.modules import user_files
from simgap.common.options import Field, Option, option_fields
from simgap.common.origin import current_date
from simgap.common.progress import show_progress

if TYPE_CHECKING:
    from simgap.common.report import Emphasis, ReportTable

FRAME_PATTERN: Final = re.compile(r'File "(?P<file>[^"]+)", line (?P<line>[0-9]+)')
"""Line of a traceback as text, which is all that a worker process sends."""


def describe_failed_effect(error: Exception) -> str | None:
    """Describe an exception that passed through the file of a user's effect; None for any other exception."""
    files = user_files()
    if not files:
        return None
    lines = "".join(traceback.format_exception(error))
    places = [found for found in FRAME_PATTERN.finditer(lines) if found["file"] in files]
    if not places:
        return None
    what = " ".join(f"{type(error).__name__}: {error}".split())
    return f"effect {places[-1]['file']}:{places[-1]['line']}: {what}; mend the effect, or leave it out"


EXIT_NOT_DONE: Final = 3
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON document and nothing else.")]


@dataclass(frozen=True, slots=True)
class VerbResult:
    """Result of a verb, as a JSON document and as a table."""

    document: dict[str, Any]
    print_table: Callable[[], None]
    is_done: bool = True
    """False although nothing is wrong with the request: an arm refused or faulted, or a diagnosis will."""
    save: Callable[[], Sequence[str]] | None = None
    """Function that writes files, and returns a line for each; a result of minutes is printed first."""
    play: Callable[[], None] | None = None
    """Function that shows the result until Ctrl-C; a program can read the result before."""


class Playable(Protocol):
    """View that a user can play."""

    def play(self) -> None:
        """Play until Ctrl-C."""


def shown(
    document: Any,
    parts: Sequence["str | Emphasis | ReportTable"],
    is_done: bool = True,
    view: Playable | None = None,
    save: Callable[[], Sequence[str]] | None = None,
) -> VerbResult:
    """Make the result of a verb from values that `to_json` takes, and from sentences and tables."""
    from simgap.common.report import print_parts, to_json

    play = None if view is None else view.play
    return VerbResult(to_json(document), lambda: print_parts(parts), is_done, save, play)


def verb(work: Callable[..., VerbResult]) -> Callable[..., None]:
    """Make a command for typer from a function that carries out a verb.

    The options are the fields of each parameter that is a request, all other parameters, and `--json`. A
    parameter `progress` is no option: it gets the function that updates the progress bar. The function
    imports its domain itself, and a request may be given as `"module.Request"`, so that `--help` loads
    neither.
    """

    def command(as_json: bool, **values: Any) -> None:
        with report_user_errors(as_json):
            result = _carry_out(work, _read_parameters(work), values)
        print_result(result.document, as_json, result.print_table)
        if result.save is not None:
            with report_user_errors(as_json=False):  # the JSON document is complete
                for line in result.save():
                    print(line, file=sys.stderr)
        if result.play is not None:
            release_stdout()
            with report_user_errors(as_json=False):
                result.play()
        if not result.is_done:
            raise typer.Exit(EXIT_NOT_DONE)

    def read_options() -> Callable[..., None]:
        options = [option for parameter in _read_parameters(work) for option in _verb_options(parameter)]
        signature = inspect.Signature([*options, _parameter("as_json", JsonOption, False)])
        command.__signature__ = signature  # type: ignore[attr-defined]
        return command

    command.__signature__ = inspect.Signature()  # type: ignore[attr-defined]
    command.read_options = read_options  # type: ignore[attr-defined]
    # each paragraph on one line, so that the screen decides its lines
    help_text = "\n\n".join(" ".join(part.split()) for part in (inspect.getdoc(work) or "").split("\n\n"))
    command.__name__, command.__doc__ = work.__name__, help_text
    return command


def _read_parameters(work: Callable[..., VerbResult]) -> tuple[inspect.Parameter, ...]:
    """Return the parameters of the function of a verb, with the classes of its requests."""

    def find(annotation: Any) -> Any:
        if not isinstance(annotation, str):
            return annotation
        module, _, name = annotation.rpartition(".")
        return getattr(import_module(module), name)

    given = inspect.signature(work).parameters.values()
    return tuple(parameter.replace(annotation=find(parameter.annotation)) for parameter in given)


def _carry_out(
    work: Callable[..., VerbResult], parameters: tuple[inspect.Parameter, ...], values: dict[str, Any]
) -> VerbResult:
    for parameter in parameters:
        if is_dataclass(parameter.annotation):
            values[parameter.name] = _build_request(parameter.annotation, values)
    current_date()  # a wrong one is refused before the work; numpy would raise an exception
    with show_progress(f"{work.__module__}.{work.__name__}", " ".join(sys.argv[1:])) as progress:
        if any(parameter.name == "progress" for parameter in parameters):
            values["progress"] = progress
        return work(**values)


def _verb_options(parameter: inspect.Parameter) -> Iterator[inspect.Parameter]:
    if is_dataclass(parameter.annotation):
        yield from _request_options(parameter.annotation, MISSING)
    elif parameter.name != "progress":
        yield parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)


def _request_options(request_type: Any, group: Any) -> Iterator[inspect.Parameter]:
    """Yield the options of a request class; `group` holds their defaults if they are a group in another."""
    for field in option_fields(request_type):
        default = field.default if group is MISSING else getattr(group, field.name)
        if field.option is None:
            yield from _request_options(field.type, default)
            continue
        kind = Annotated[_typer_type(field), _typer_option(field, field.option)]  # type: ignore[valid-type]
        yield _parameter(field.name, kind, None if default == () else default)
        if field.option.help_without is not None and default is not None:
            flag = typer.Option(f"--no-{field.label}", help=field.option.help_without)
            yield _parameter(f"no_{field.name}", Annotated[bool, flag], False)


def _typer_type(field: Field) -> Any:
    """Return the type for typer, which knows lists instead of tuples; `check_options` checks literals."""
    if not field.is_list:
        return str if get_origin(field.type) is Literal else field.type
    values = list[get_args(field.type)[0]]  # type: ignore[misc, valid-type]
    return values | None if field.default == () else values


def _typer_option(field: Field, option: Option) -> Any:
    if option.is_argument:
        return typer.Argument(help=option.help, metavar=option.metavar)
    return typer.Option(option.name or f"--{field.label}", help=option.help, metavar=option.metavar)


def _parameter(name: str, kind: Any, default: Any) -> inspect.Parameter:
    if default is MISSING:
        default = inspect.Parameter.empty
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, annotation=kind, default=default)


def _build_request(request_type: Any, values: dict[str, Any]) -> Any:
    """Build a request, and remove its options from the values."""
    made: dict[str, Any] = {}
    for field in option_fields(request_type):
        if field.option is None:
            made[field.name] = _build_request(field.type, values)
            continue
        value = values.pop(field.name)
        if values.pop(f"no_{field.name}", False):
            value = None
        made[field.name] = tuple(value or ()) if field.is_list else value
    return request_type(**made)


def print_result(document: dict[str, Any], as_json: bool, print_table: Callable[[], None]) -> None:
    """Print a result as JSON for a program, or as a table for a person."""
    if as_json:
        print(json.dumps(document, indent=2, allow_nan=False))
    else:
        print_table()


@contextmanager
def report_user_errors(as_json: bool) -> Iterator[None]:
    """Print an error of the user, and exit with its status; an exception in an effect of the user is one."""
    try:
        yield
    except UserError as error:
        _report(describe_problems(error), as_json)
        raise typer.Exit(error.exit_status) from error
    except Exception as error:
        sentence = describe_failed_effect(error)
        if sentence is None:
            raise  # a bug
        _report(sentence, as_json)
        raise typer.Exit(EXIT_BAD_INPUT) from error


def _report(sentence: str, as_json: bool) -> None:
    if as_json:
        print(json.dumps({"error": sentence}))
    print(sentence, file=sys.stderr)
