"""The verb `budget`; thin."""

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
        int, typer.Option(help="How many in all, over the workspace and its branches.")
    ] = 15_000,
    seed: Annotated[int, typer.Option(help="Of the random poses.")] = 0,
    gravity: Annotated[str, typer.Option(help="mars or earth.", metavar="mars|earth")] = "mars",
    params: ParamsOption = None,
    reproduce: Annotated[
        bool, typer.Option("--reproduce", help="Find the magnitudes that would give the paper's rows.")
    ] = False,
    report: ReportOption = None,
    as_json: JsonOption = False,
) -> None:
    """How accurate the arm is to be expected, before it is built: ten sources of error at seven frames.

    Every source is a small turn or shift of some frames, propagated to the tool over the primary workspace.
    What 99.73 percent of the poses stay within is set beside the paper's tables, with what makes it up.

    Example: marsarm budget --case accuracy --tool apxs --report budget.html
    """
    from ground.accuracy.budget_report import budget_json, budget_table, save_budget_page
    from ground.accuracy.budget_request import BudgetRequest, run_budget
    from ground.common.progress_bar import progress_bar
    from ground.common.requests import BadRequest

    request = BudgetRequest(case, tool, poses, seed, params, gravity, report, reproduce)
    try:
        with progress_bar() as progress:
            found = run_budget(request, progress)
            if report is not None:
                save_budget_page(found, report)
    except BadRequest as error:
        fail(str(error), EXIT_BAD_INPUT, as_json)
    print_result(budget_json(found), as_json, lambda: budget_table(found))
