"""Define the verbs of the error budget: `budget` and `monte-carlo`."""

from marsarm.accuracy.request import BudgetRequest, MonteCarloRequest
from simgap.common.progress import Progress
from simgap.common.verb import VerbResult, verb


@verb
def budget(request: BudgetRequest, progress: Progress) -> VerbResult:
    """Predict the accuracy of the arm before it is built, from eleven sources of error at seven frames.

    Every source is a small rotation or translation of some frames. It is propagated to the tool over the
    primary workspace. The bound of 99.73 percent of the poses is compared with the paper's tables.

    Example: marsarm budget --case accuracy --tool apxs --report budget.html
    """
    from marsarm.accuracy.budget import run_budget
    from marsarm.accuracy.budget_report import (
        budget_json,
        budget_table,
        save_budget_page,
        save_budget_picture,
    )

    result = run_budget(request, progress)
    problem = None if request.picture is None else save_budget_picture(result, request.picture)
    if request.report is not None:
        save_budget_page(result, request.report)
    return VerbResult(
        {**budget_json(result), "picture_problem": problem}, lambda: budget_table(result, problem)
    )


@verb
def monte_carlo(request: MonteCarloRequest, progress: Progress) -> VerbResult:
    """Check the error budget on arms with sampled errors, which flight software moves.

    Every arm has errors of its own, and every move adds random ones. The position error of the tool is
    compared with the bounds of the budget. Arm K is the same whatever other arms there are.

    Example: marsarm monte-carlo --case mars --arms 200 --results mars.jsonl --report mars.html
    """
    from marsarm.accuracy.monte_carlo import run_monte_carlo
    from marsarm.accuracy.monte_carlo_report import (
        monte_carlo_json,
        monte_carlo_table,
        one_arm_table,
        save_monte_carlo_page,
    )

    result = run_monte_carlo(request, progress)
    if request.report is not None:
        save_monte_carlo_page(result, request.report)
    print_table = monte_carlo_table if request.only is None else one_arm_table
    return VerbResult(monte_carlo_json(result), lambda: print_table(result), is_done=bool(result.trials))
