"""Blind cases, whose truth is sealed before they are recorded: make, solve and score them.

`python -m validation.blind make|solve|score|leave-out`; `python -m validation.blind.brief` does the first
three in a minute.
"""

import sys
from pathlib import Path
from typing import Annotated

import typer

from marsarm.common.pool import select_runner
from simgap.common.files import check_output
from simgap.common.options import CLUSTER_HELP
from simgap.common.progress import Progress
from simgap.common.verb import VerbCommand, VerbResult, verb
from validation.blind.arm_solver import ARM_SOLVER, load_campaign_sensitivities
from validation.blind.folder import check_jobs, check_make
from validation.blind.leave_out import score_left_out
from validation.blind.make import make_cases
from validation.blind.score_folder import score_folder
from validation.blind.solve import solve_cases
from validation.blind.table import plain, rate_text, save_score, score_json, score_markdown

FolderArgument = Annotated[Path, typer.Argument(help="Folder made by `make`.", metavar="FOLDER")]
JobsOption = Annotated[int | None, typer.Option(help="Processes; all cores if not given.")]
ClusterOption = Annotated[str | None, typer.Option(help=CLUSTER_HELP, metavar="HOST:PORT")]

app = typer.Typer(
    name="python -m validation.blind",
    help="Make, solve and score cases of the diagnosis whose truth is sealed before they are recorded.\n\n"
    "Example: python -m validation.blind make --cases 200 --seed 1 --out blind",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.command(cls=VerbCommand)
@verb
def make(
    progress: Progress,
    out: Annotated[Path, typer.Option(help="Folder of the cases; a new one, or one to continue.")],
    cases: Annotated[int, typer.Option(help="Number of cases.")] = 200,
    seed: Annotated[int, typer.Option(help="Seed of effects, sizes, arms and noise.")] = 0,
    jobs: JobsOption = None,
    cluster: ClusterOption = None,
) -> VerbResult:
    """Record blind cases: with no effect, one, two, or one that is in no catalogue.

    The digest of the truth is in digest.txt before any case is recorded. An interrupted run continues.

    Example: python -m validation.blind make --cases 200 --seed 1 --out blind
    """

    def publish(digest: str) -> None:
        print(f"SHA-256 of the truth: {digest}", file=sys.stderr)

    check_make(cases, seed, out, jobs)
    made = make_cases(out, cases, seed, select_runner(jobs, cluster), progress, publish)
    document = {
        "digest": made.digest,
        "cases": made.cases,
        "recorded": made.recorded,
        "left_out": list(made.left_out),
    }
    return VerbResult(document, lambda: print(f"{made.cases} cases, {made.recorded} of them recorded now"))


@app.command(cls=VerbCommand)
@verb
def solve(
    progress: Progress, folder: FolderArgument, jobs: JobsOption = None, cluster: ClusterOption = None
) -> VerbResult:
    """Diagnose every blind case without a result; the truth is not read.

    Example: python -m validation.blind solve blind
    """
    check_jobs(jobs)
    now, cases = solve_cases(folder, ARM_SOLVER, select_runner(jobs, cluster), progress)
    return VerbResult(
        {"solved": now, "cases": cases}, lambda: print(f"{cases} cases, {now} of them solved now")
    )


@app.command()
@verb
def score(
    progress: Progress,
    folder: FolderArgument,
    out: Annotated[
        Path | None, typer.Option(help="Write the score as a page.", metavar="FILE.md|FILE.json")
    ] = None,
    partial: Annotated[bool, typer.Option("--partial", help="Score only solved cases.")] = False,
) -> VerbResult:
    """Compare the results of blind cases with their truth, whose digest is checked first.

    Example: python -m validation.blind score blind --out blind.md
    """
    if out is not None:
        check_output(out, (".md", ".json"), "out")
    found = score_folder(folder, load_campaign_sensitivities, partial, progress)
    if out is not None:
        save_score(found, out)
    return VerbResult(score_json(found), lambda: print(score_markdown(found), end=""))


@app.command(name="leave-out", cls=VerbCommand)
@verb
def leave_out(
    progress: Progress,
    folder: FolderArgument,
    cases: Annotated[int, typer.Option(help="Greatest number of cases.")] = 60,
    jobs: JobsOption = None,
    cluster: ClusterOption = None,
) -> VerbResult:
    """Diagnose solved cases again with a catalogue that lacks their effect: no other one may be named.

    Example: python -m validation.blind leave-out blind --cases 60
    """
    check_jobs(jobs)
    found = score_left_out(folder, ARM_SOLVER, cases, select_runner(jobs, cluster), progress)

    def print_score() -> None:
        print(f"named as another effect: {rate_text(found.named)}")
        print(f"anything reported: {rate_text(found.reported)}")
        print(f"right place, of those with places: {rate_text(found.right_place)}")
        for text in found.wrong:
            print(text)

    return VerbResult(plain(found), print_score)


if __name__ == "__main__":
    app()
