"""Define the verbs that move an arm or show it: `show`, `place`, `run`, `hardstop` and `view`."""

from typing import TYPE_CHECKING, Annotated

import typer

from simgap.common.progress import Progress
from simgap.common.verb import VerbResult, shown, verb

if TYPE_CHECKING:  # `verb` imports the requests of a verb that is chosen
    import marsarm.common.options
    import marsarm.runs.request

ListOption = Annotated[bool, typer.Option("--list", help="Run nothing; list the built-in scenarios.")]


@verb
def show(request: "marsarm.runs.request.ShowRequest", progress: Progress) -> VerbResult:
    """Place an instrument, and open a page in the browser that plays it.

    The options are those of `place`. Without a display it says where the page is; any browser plays it, also
    on another machine.

    Example: marsarm show --tool mahli --arm as-built:7
    """
    from marsarm.runs.place import place
    from marsarm.runs.report import place_document, place_parts
    from marsarm.view.page import OpenedPage

    report = place(request, progress)
    page = report.execution.artifacts.page
    is_done = report.execution.result.outcome == "done"
    view = None if page is None else OpenedPage(page)
    return shown(place_document(report), place_parts(report), is_done, view=view)


@verb
def place(request: "marsarm.runs.request.PlaceRequest", progress: Progress) -> VerbResult:
    """Unstow, place an instrument on a rock, and retract.

    RNAV is x forward, y right, z down, from the ground below the rover: a rock 0.25 m high has z = -0.25.

    Example: marsarm place --tool mahli --target 2.1 0 -0.2 --normal -0.4 0 -1 --tilt-pitch 10
    """
    from marsarm.runs.place import place
    from marsarm.runs.report import place_document, place_parts

    report = place(request, progress)
    is_done = report.execution.result.outcome == "done"
    return shown(place_document(report), place_parts(report), is_done)


@verb
def hardstop(request: "marsarm.runs.request.HardstopRequest", progress: Progress) -> VerbResult:
    """Run joints against their negative hardstops and set the encoder zeros there.

    Flight software begins without any zero. Errors are relative to the true hardstop of the arm.

    Example: marsarm hardstop --joint elbow --arm as-built:7 --temperature -40 --picture elbow.png
    """
    from marsarm.runs.hardstop import hardstop, save_hardstop_figure
    from marsarm.runs.report import hardstop_document, hardstop_parts

    report = hardstop(request, progress)
    if request.picture is not None:
        save_hardstop_figure(report.result, request.picture)
    is_done = report.result.outcome == "done"
    return shown(hardstop_document(report), hardstop_parts(report), is_done)


@verb
def run(
    request: "marsarm.runs.request.RunRequest", progress: Progress, lists: ListOption = False
) -> VerbResult:
    """Run a scenario in the closed loop, and check it against the true motion of the arm.

    Example: marsarm run tool-change --arm calibrated:7 --tilt 10 -5 --page sol46.html
    """
    from marsarm.runs.report import run_document, run_parts, scenarios_document, scenarios_parts

    if lists:
        from sim.scenario.file import built_in_scenarios, load_scenario

        loaded = tuple(load_scenario(name) for name in built_in_scenarios())
        return shown(scenarios_document(loaded), scenarios_parts(loaded))
    from marsarm.runs.scenario import run_scenario

    report = run_scenario(request, progress)
    return shown(run_document(report), run_parts(report), report.passed)


@verb
def view(request: "marsarm.common.options.ViewRequest", progress: Progress) -> VerbResult:
    """Write a page that plays a log without a server, and open it in the browser.

    It shows the true arm, the arm that flight software believes, rover, rock, contact force, plots and
    events.

    Example: marsarm view run.mcap --html run.html
    """
    from marsarm.view.page import OpenedPage, view, view_document, view_parts

    report = view(request, progress)
    opened = OpenedPage(report.page) if request.html is None else None
    return shown(view_document(report), view_parts(report), view=opened)
