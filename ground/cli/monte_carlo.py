"""Define the verb `monte-carlo`."""

import os
from pathlib import Path
from typing import Annotated

import typer

from ground.cli.options import EXIT_ARM_SAFE, EXIT_BAD_INPUT, JsonOption, ReportOption, fail, print_result

CaseOption = Annotated[
    str, typer.Option(help="accuracy, repeatability, mars or mars-repeatability.", metavar="CASE")
]
BuiltOption = Annotated[
    str,
    typer.Option(
        help="drawn: the nominal arm with every source of the case. calibrated or as-built: such arms, "
        "with the sources that the case adds to them.",
        metavar="drawn|calibrated|as-built",
    ),
]
HowOption = Annotated[
    str,
    typer.Option(
        help="closed-loop: plant and flight software. statics: the equilibrium of motors, gears and springs "
        "after a move, thirty times faster.",
        metavar="closed-loop|statics",
    ),
]
SeedOption = Annotated[
    int, typer.Option(help="Seed of arms, places and moves; calibrated arm K is calibrated:SEED+K.")
]
OnlyOption = Annotated[
    int | None,
    typer.Option(help="Run arm number K alone; its results are the same as among others.", metavar="K"),
]
ParamsOption = Annotated[
    Path | None,
    typer.Option(
        help="TOML file of flight parameters that replace nominal ones; {seed} in its name stands for the "
        "seed of an arm.",
        metavar="FILE.toml",
    ),
]
ResultsOption = Annotated[
    Path | None,
    typer.Option(
        help="Write the measurements arm by arm; an interrupted run continues from this file.",
        metavar="FILE.jsonl",
    ),
]


def monte_carlo(
    case: CaseOption = "accuracy",
    built: BuiltOption = "drawn",
    arms: Annotated[int, typer.Option(help="Number of arms.")] = 500,
    places: Annotated[int, typer.Option(help="Number of places that each arm is moved to.")] = 1,
    how: HowOption = "closed-loop",
    seed: SeedOption = 0,
    only: OnlyOption = None,
    workers: Annotated[int | None, typer.Option(help="Number of processes; all cores if not given.")] = None,
    cluster: Annotated[
        bool, typer.Option("--cluster", help="Run on the Ray cluster that RAY_ADDRESS names.")
    ] = False,
    params: ParamsOption = None,
    results: ResultsOption = None,
    report: ReportOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check the error budget on arms with sampled errors, which flight software moves.

    Every arm has errors of its own, and every move adds random ones. The position error of the tool is
    compared with the bounds of the budget. Arm K is the same whatever other arms there are.

    Example: marsarm monte-carlo --case mars --arms 200 --results mars.jsonl --report mars.html
    """
    from ground.accuracy.monte_carlo import MonteCarloRequest, run_monte_carlo
    from ground.accuracy.monte_carlo_report import (
        monte_carlo_json,
        monte_carlo_table,
        one_arm_table,
        save_monte_carlo_page,
    )
    from ground.common.errors import BadRequest
    from ground.common.progress import progress_bar

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
            result = run_monte_carlo(request, progress)
            if report is not None:
                save_monte_carlo_page(result, report)
    except BadRequest as error:
        fail(str(error), EXIT_BAD_INPUT, as_json)
    print_table = monte_carlo_table if only is None else one_arm_table
    print_result(monte_carlo_json(result), as_json, lambda: print_table(result))
    if not result.trials:
        raise typer.Exit(EXIT_ARM_SAFE)
