"""The verb `monte-carlo`; thin."""

import os
from pathlib import Path
from typing import Annotated

import typer

from ground.cli.options import EXIT_ARM_SAFE, EXIT_BAD_INPUT, JsonOption, ReportOption, fail, print_result


def monte_carlo(
    case: Annotated[
        str, typer.Option(help="accuracy, repeatability, mars or mars-repeatability.", metavar="CASE")
    ] = "accuracy",
    built: Annotated[
        str,
        typer.Option(
            help="drawn: the nominal arm with every source of the case. calibrated or as-built: such arms, "
            "with what the case adds to them.",
            metavar="drawn|calibrated|as-built",
        ),
    ] = "drawn",
    arms: Annotated[int, typer.Option(help="How many.")] = 500,
    places: Annotated[int, typer.Option(help="How many each is moved to.")] = 1,
    how: Annotated[
        str,
        typer.Option(
            help="closed-loop: plant and flight software. statics: where a move leaves motors, gears and "
            "springs at rest, thirty times faster.",
            metavar="closed-loop|statics",
        ),
    ] = "closed-loop",
    seed: Annotated[
        int, typer.Option(help="Of arms, places and moves; calibrated arm K is calibrated:SEED+K.")
    ] = 0,
    only: Annotated[
        int | None, typer.Option(help="Run arm number K alone, as it is among the others.", metavar="K")
    ] = None,
    workers: Annotated[int | None, typer.Option(help="Processes; all cores if not given.")] = None,
    cluster: Annotated[
        bool, typer.Option("--cluster", help="On the Ray cluster that RAY_ADDRESS names.")
    ] = False,
    params: Annotated[
        Path | None,
        typer.Option(
            help="TOML with flight parameters over the nominal ones; {seed} in its name stands for an arm's.",
            metavar="FILE.toml",
        ),
    ] = None,
    results: Annotated[
        Path | None,
        typer.Option(
            help="Keep what is measured, arm by arm; a run that was stopped goes on from there.",
            metavar="FILE.jsonl",
        ),
    ] = None,
    report: ReportOption = None,
    as_json: JsonOption = False,
) -> None:
    """Arms drawn by the error budget, moved by flight software, measured: does the budget hold?

    Every arm has errors of its own; every move leaves some to chance. By how much the tool misses its place
    is held against the bounds of the budget there. Arm K is the same whichever others there are.

    Example: marsarm monte-carlo --case mars --arms 200 --results mars.jsonl --report mars.html
    """
    from ground.accuracy.monte_carlo import MonteCarloRequest, run_monte_carlo
    from ground.accuracy.monte_carlo_report import (
        monte_carlo_json,
        monte_carlo_table,
        one_arm_table,
        save_monte_carlo_page,
    )
    from ground.common.progress_bar import progress_bar
    from ground.common.requests import BadRequest

    request = MonteCarloRequest(
        case=case,
        built=built,
        arms=arms,
        places=places,
        how=how,
        seed=seed,
        only=only,
        workers=(os.cpu_count() or 1) if workers is None else workers,
        cluster=cluster,
        params=params,
        results=results,
        report=report,
    )
    try:
        with progress_bar() as progress:
            found = run_monte_carlo(request, progress)
            if report is not None:
                save_monte_carlo_page(found, report)
    except BadRequest as error:
        fail(str(error), EXIT_BAD_INPUT, as_json)
    print_table = monte_carlo_table if only is None else one_arm_table
    print_result(monte_carlo_json(found), as_json, lambda: print_table(found))
    if not found.trials:
        raise typer.Exit(EXIT_ARM_SAFE)
