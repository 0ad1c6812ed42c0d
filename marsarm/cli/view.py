"""Define the verb `view`."""

from marsarm.view.request import ViewRequest
from simgap.common.progress import Progress
from simgap.common.verb import VerbResult, verb


@verb
def view(request: ViewRequest, progress: Progress) -> VerbResult:
    """Play a log in the browser, or write a page that plays it without a server.

    Both show the true arm, the arm that flight software believes, rover, rock, contact force, plots and
    events. The viewer listens on 127.0.0.1 only, until Ctrl-C, and needs the optional package viser. The page
    needs a browser only.

    Example: marsarm view run.mcap --html run.html
    """
    from marsarm.view.view import view, view_json, view_table

    report = view(request, progress)
    play = None if report.viewer is None else report.play
    return VerbResult(view_json(report), lambda: view_table(report), play=play)
