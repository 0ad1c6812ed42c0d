"""Error budget as a request of the command line."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from fsw.config import configure, digest
from fsw.dictionary.enums import Tool
from ground.accuracy.budget import Budget, compute_budgets
from ground.accuracy.reproduce import TABLE_3, TABLE_4, MagnitudeFit, PaperRow, reproduce
from ground.accuracy.sources import ErrorModel, load_error_model
from ground.common.errors import BadRequest
from ground.common.files import check_distinct_files, check_output
from ground.common.progress import Progress
from ground.common.requests import check_seed, make_world, select_arm

ALL: Final = "all"
POSES: Final = (100, 200_000)
"""Smallest and largest number of poses."""


@dataclass(frozen=True, slots=True)
class BudgetRequest:
    """Request for an error budget."""

    case: str = ALL
    tool: str = ALL
    poses: int = 15_000
    seed: int = 0
    params: Path | None = None
    gravity: str = "mars"
    report: Path | None = None
    reproduce: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class BudgetReport:
    """Result of a request for an error budget."""

    request: BudgetRequest
    model: ErrorModel
    budgets: Mapping[str, Budget]
    rows: tuple[tuple[PaperRow, float], ...]
    """Rows of the paper for the requested cases, with our values."""
    reproduced: tuple[MagnitudeFit, ...]
    """Magnitudes that reproduce Tables 3 and 4 of the paper, if requested."""
    params_sha256: str


def run_budget(request: BudgetRequest, progress: Progress) -> BudgetReport:
    """Compute the budgets of one case or of all cases.

    Raises:
        BadRequest: The request is wrong; nothing was written.
    """
    model = load_error_model()
    names = tuple(model.case) if request.case == ALL else (request.case,)
    if request.case not in (ALL, *model.case):
        raise BadRequest(f"case: {request.case!r} is not known; there are {', '.join(model.case)} and {ALL}")
    tools = _parse_tools(request.tool)
    check_seed(request.seed)
    least, most = POSES
    if not least <= request.poses <= most:
        raise BadRequest(f"poses: {request.poses} is not within {least} .. {most}")
    gravity = make_world(request.gravity, 0.0, 0.0, "gravity").gravity_N_m_s2
    check_distinct_files({"params": request.params, "report": request.report})
    if request.report is not None:
        check_output(request.report, (".html",), "report")
    params = select_arm("nominal", request.params).params
    config = configure(params)
    budgets = compute_budgets(model, names, config, gravity, tools, request.poses, request.seed, progress)
    rows = [
        (row, budgets[row.case].estimate("paper", row.component))
        for row in (*TABLE_3, *TABLE_4)
        if row.case in budgets
    ]
    reproduced: list[MagnitudeFit] = []
    for table in (TABLE_3, TABLE_4) if request.reproduce else ():
        progress(len(reproduced), 2, "reproducing")
        reproduced.append(reproduce(model, table, config, gravity, request.seed))
    return BudgetReport(request, model, budgets, tuple(rows), tuple(reproduced), digest(params))


def _parse_tools(name: str) -> tuple[Tool, ...]:
    known = {tool.name.lower(): tool for tool in Tool}
    if name.lower() == ALL:
        return tuple(Tool)
    if name.lower() not in known:
        raise BadRequest(f"tool: {name!r} is not known; there are {', '.join(known)} and {ALL}")
    return (known[name.lower()],)
