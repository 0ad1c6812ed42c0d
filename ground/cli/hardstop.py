"""Define the verb `hardstop`."""

from typing import Annotated

import typer

from ground.cli.verb import VerbResult, verb
from ground.common.errors import BadRequest
from ground.common.progress import Progress
from ground.runs.request import HardstopRequest

AllOption = Annotated[
    bool, typer.Option("--all", help="All joints, one after the other, as flight software does it.")
]
PlanOption = Annotated[
    bool, typer.Option("--plan", help="Move nothing; show the poses and the torques that they equalise.")
]


@verb
def hardstop(
    request: HardstopRequest, progress: Progress, all_joints: AllOption = False, plan: PlanOption = False
) -> VerbResult:
    """Run joints against their negative hardstops and set the encoder zeros there.

    Flight software begins without any zero. Errors are relative to the true hardstop of the arm.

    Example: marsarm hardstop --joint elbow --arm as-built:7 --temperature -40 --picture elbow.png
    """
    from ground.runs.hardstop import hardstop, plan_stops
    from ground.runs.hardstop_tables import hardstop_json, hardstop_table, plan_json, plan_table

    if all_joints and request.joint is not None:
        raise BadRequest(
            f"all: --joint {request.joint} asks for one joint, --all for all; give one of the two"
        )
    if plan:
        plans = plan_stops(request)
        return VerbResult(plan_json(plans), lambda: plan_table(plans))
    report = hardstop(request, progress)
    return VerbResult(hardstop_json(report), lambda: hardstop_table(report), report.outcome == "done")
