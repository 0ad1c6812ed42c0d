"""Define the verb `budget`."""

from typing import Annotated

import typer

from ground.cli.options import EXIT_BAD_INPUT, JsonOption, ParamsOption, ReportOption, fail, print_result


def budget(
    case: Annotated[
        str,
        typer.Option(
            help="accuracy and repeatability: before calibration, the paper's Table 3; mars and "
            "mars-repeatability: after it, Table 4.",
            metavar="CASE|all",
        ),
    ] = "all",
    tool: Annotated[
        str, typer.Option(help="drill, drt, mahli, apxs or portion.", metavar="TOOL|all")
    ] = "all",
    poses: Annotated[
        int, typer.Option(help="Number of random poses in the workspace, over all branches.")
    ] = 15_000,
    seed: Annotated[int, typer.Option(help="Seed of the random poses.")] = 0,
    gravity: Annotated[str, typer.Option(help="mars or earth.", metavar="mars|earth")] = "mars",
    params: ParamsOption = None,
    reproduce: Annotated[
        bool, typer.Option("--reproduce", help="Find the magnitudes that reproduce the paper's rows.")
    ] = False,
    report: ReportOption = None,
    as_json: JsonOption = False,
) -> None:
    """Predict the accuracy of the arm before it is built, from ten sources of error at seven frames.

    Every source is a small rotation or translation of some frames. It is propagated to the tool over the
    primary workspace. The bound of 99.73 percent of the poses is compared with the paper's tables.

    Example: marsarm budget --case accuracy --tool apxs --report budget.html
    """
    from ground.accuracy.budget_report import budget_json, budget_table, save_budget_page
    from ground.accuracy.budget_request import BudgetRequest, run_budget
    from ground.common.errors import BadRequest
    from ground.common.progress import progress_bar

    request = BudgetRequest(case, tool, poses, seed, params, gravity, report, reproduce)
    try:
        with progress_bar() as progress:
            result = run_budget(request, progress)
            if report is not None:
                save_budget_page(result, report)
    except BadRequest as error:
        fail(str(error), EXIT_BAD_INPUT, as_json)
    print_result(budget_json(result), as_json, lambda: budget_table(result))
