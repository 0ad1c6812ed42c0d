"""Define the verbs of runs: `place`, `hardstop`, `run` and `scenarios`."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated

import typer

from marsarm.runs.request import HardstopRequest, PlaceRequest, RunRequest
from simgap.common.errors import BadRequest
from simgap.common.progress import Progress
from simgap.common.verb import VerbResult, verb

if TYPE_CHECKING:
    from marsarm.view.live import LiveView

AllOption = Annotated[
    bool, typer.Option("--all", help="All joints, one after the other, as flight software does it.")
]
PlanOption = Annotated[
    bool, typer.Option("--plan", help="Move nothing; show the poses and the torques that they equalise.")
]


def _player(view: "LiveView | None") -> Callable[[], None] | None:
    """Return the function that plays a run in its viewer after the result was printed."""
    return None if view is None else view.play


@verb
def place(request: PlaceRequest, progress: Progress) -> VerbResult:
    """Unstow, place an instrument on a rock, and retract.

    RNAV is x forward, y right, z down, from the ground below the rover: a rock 0.25 m high has z = -0.25.

    Example: marsarm place --tool mahli --target 2.1 0 -0.2 --normal -0.4 0 -1 --tilt-pitch 10
    """
    from marsarm.runs.place import place
    from marsarm.runs.tables import place_json, place_table

    report = place(request, progress)
    is_done = report.execution.result.outcome == "done"
    play = _player(report.execution.view)
    return VerbResult(place_json(report), lambda: place_table(report), is_done, play=play)


@verb
def hardstop(
    request: HardstopRequest, progress: Progress, all_joints: AllOption = False, plan: PlanOption = False
) -> VerbResult:
    """Run joints against their negative hardstops and set the encoder zeros there.

    Flight software begins without any zero. Errors are relative to the true hardstop of the arm.

    Example: marsarm hardstop --joint elbow --arm as-built:7 --temperature -40 --picture elbow.png
    """
    from marsarm.runs.hardstop import hardstop, plan_stops
    from marsarm.runs.hardstop_report import (
        hardstop_json,
        hardstop_table,
        plan_json,
        plan_table,
        save_hardstop_figure,
    )

    if all_joints and request.joint is not None:
        raise BadRequest(
            f"all: --joint {request.joint} asks for one joint, --all for all; give one of the two"
        )
    if plan:
        plans = plan_stops(request)
        return VerbResult(plan_json(plans), lambda: plan_table(plans))
    report = hardstop(request, progress)
    problem = None if request.picture is None else save_hardstop_figure(report.runs, request.picture)
    document = hardstop_json(report, problem)
    is_done = report.outcome == "done"
    return VerbResult(document, lambda: hardstop_table(report, problem), is_done, play=_player(report.view))


@verb
def run(request: RunRequest, progress: Progress) -> VerbResult:
    """Run a scenario in the closed loop, and check it against the true motion of the arm.

    Example: marsarm run tool-change --arm calibrated:7 --tilt 10 -5 --movie sol46.mp4
    """
    from marsarm.runs.scenario import run_scenario
    from marsarm.runs.tables import run_json, run_table

    report = run_scenario(request, progress)
    play = _player(report.execution.view)
    return VerbResult(run_json(report), lambda: run_table(report), report.passed, play=play)


@verb
def scenarios() -> VerbResult:
    """List the built-in scenarios.

    Example: marsarm scenarios --json
    """
    from marsarm.runs.tables import scenarios_json, scenarios_table
    from sim.scenario.file import built_in_scenarios, load_scenario

    loaded = tuple(load_scenario(name) for name in built_in_scenarios())
    return VerbResult({"scenarios": scenarios_json(loaded)}, lambda: scenarios_table(loaded))
