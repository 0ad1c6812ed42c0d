"""The verbs `gap ...`; thin."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from ground.cli.options import (
    EXIT_BAD_INPUT,
    ArmOption,
    EffectOption,
    JsonOption,
    ParamsOption,
    SeedOption,
    fail,
    print_result,
)

EXIT_LEAKED = 1

FolderArgument = Annotated[
    Path, typer.Argument(help="A folder that `gap blind make` made.", metavar="FOLDER")
]
JobsOption = Annotated[int | None, typer.Option(help="Processes; all cores if not given.")]

gap_app = typer.Typer(
    help="Record what a diagnosis of the gap is made of, and try how good such diagnoses are.\n\n"
    "Example: marsarm gap record --out logs",
    no_args_is_help=True,
)
blind_app = typer.Typer(
    help="Cases whose truth is sealed before they are recorded: made, solved, and scored once.\n\n"
    "Example: marsarm gap blind make --cases 200 --seed 1 --out blind",
    no_args_is_help=True,
)
gap_app.add_typer(blind_app, name="blind")


@gap_app.command()
def record(
    out: Annotated[Path, typer.Option(help="A new folder for the logs.", metavar="DIR")],
    arm: ArmOption = "nominal",
    effect: EffectOption = None,
    params: ParamsOption = None,
    seed: SeedOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Record the campaign of motions that `marsarm diagnose` is made for; half a minute.

    Logs hold no truth of the plant. Motions on which a diagnosis may be tried are in DIR/held-out.

    Example: marsarm gap record --effect link-length:arm3.x:length_m=0.003 --out logs
    """
    from ground.common.progress_bar import progress_bar
    from ground.diagnosis.arm.recorded import RecordRequest, check_record, recorded

    request = RecordRequest(out, arm, tuple(effect or ()), params, seed)
    with _bad_input(as_json):
        check_record(request)
        with progress_bar() as progress:
            paths = recorded(request, progress)
    document = {"logs": [str(path) for path in paths]}
    print_result(document, as_json, lambda: print(f"{len(paths)} logs in {out}"))


@blind_app.command()
def make(
    out: Annotated[Path, typer.Option(help="Folder of the cases; a new one, or one to go on with.")],
    cases: Annotated[int, typer.Option(help="How many.")] = 200,
    seed: Annotated[int, typer.Option(help="Of effects, sizes, arms and noise.")] = 0,
    jobs: JobsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Record blind cases: with no effect, one, two, or one that is in no catalogue.

    The digest of the truth is in digest.txt before any case is recorded. What was stopped goes on.

    Example: marsarm gap blind make --cases 200 --seed 1 --out blind
    """
    from ground.common.pool import local_runner
    from ground.common.progress_bar import progress_bar
    from ground.diagnosis.arm.blind.make import make as make_cases
    from ground.diagnosis.arm.blind.sealed import TellsTruth
    from ground.diagnosis.blind.request import check_make

    def publish(digest: str) -> None:
        print(f"SHA-256 of the truth: {digest}", file=sys.stderr)

    with _bad_input(as_json):
        check_make(cases, seed, out, _worker_count(jobs))
        try:
            with progress_bar() as progress:
                made = make_cases(out, cases, seed, local_runner(_worker_count(jobs)), progress, publish)
        except TellsTruth as error:
            fail(str(error), EXIT_LEAKED, as_json)
    document = {
        "digest": made.digest,
        "cases": made.cases,
        "recorded": made.recorded,
        "left_out": list(made.left_out),
    }
    print_result(
        document, as_json, lambda: print(f"{made.cases} cases, {made.recorded} of them recorded now")
    )


@blind_app.command()
def solve(folder: FolderArgument, jobs: JobsOption = None, as_json: JsonOption = False) -> None:
    """Diagnose every blind case that is not solved yet; the truth is not looked at.

    Example: marsarm gap blind solve blind
    """
    from ground.common.pool import local_runner
    from ground.common.progress_bar import progress_bar
    from ground.diagnosis.arm.blind.solver import ARM
    from ground.diagnosis.blind.request import check_jobs
    from ground.diagnosis.blind.solve import solve as solve_cases

    with _bad_input(as_json), progress_bar() as progress:
        check_jobs(_worker_count(jobs))
        now, cases = solve_cases(folder, ARM, local_runner(_worker_count(jobs)), progress)
    print_result(
        {"solved": now, "cases": cases}, as_json, lambda: print(f"{cases} cases, {now} of them solved now")
    )


@blind_app.command()
def score(
    folder: FolderArgument,
    out: Annotated[
        Path | None, typer.Option(help="Write the score as a page.", metavar="FILE.md|FILE.json")
    ] = None,
    partial: Annotated[bool, typer.Option("--partial", help="Score what is solved.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Hold what was said of blind cases against their truth, whose digest is checked first.

    Example: marsarm gap blind score blind --out blind.md
    """
    from ground.common.files import check_output
    from ground.common.progress_bar import progress_bar
    from ground.diagnosis.arm.blind.evidence import kept_campaign
    from ground.diagnosis.blind.scored import scored
    from ground.diagnosis.blind.table import save_score, score_json, score_markdown

    with _bad_input(as_json), progress_bar() as progress:
        if out is not None:
            check_output(out, (".md", ".json"), "out")
        found = scored(folder, kept_campaign, partial, progress)
        if out is not None:
            save_score(found, out)
    print_result(score_json(found), as_json, lambda: print(score_markdown(found), end=""))


@contextmanager
def _bad_input(as_json: bool) -> Iterator[None]:
    from ground.common.files import BadOutput
    from ground.common.requests import BadRequest
    from ground.diagnosis.arm.logs import NotForDiagnosis

    try:
        yield
    except (BadRequest, BadOutput, NotForDiagnosis) as error:
        fail(str(error), EXIT_BAD_INPUT, as_json)


def _worker_count(asked: int | None) -> int:
    return (os.cpu_count() or 1) if asked is None else asked
