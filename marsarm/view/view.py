"""View of a log: check the request, then serve it or write its page."""

from dataclasses import dataclass
from typing import Any

from marsarm.view.html import save_page
from marsarm.view.request import ViewRequest
from marsarm.view.server import Viewer
from marsarm.view.watched_run import WatchedRun, watch_log
from simgap.common.console import plain_console, pluralize
from simgap.common.options import check_options
from simgap.common.progress import Progress


@dataclass(frozen=True, slots=True, eq=False)
class ViewReport:
    """View of a log."""

    request: ViewRequest
    run: WatchedRun
    page_bytes: int | None
    """Size of the page; None if the log is served."""
    viewer: Viewer | None
    """Viewer that serves the log; None if a page was written."""

    def play(self) -> None:
        """Serve the log until Ctrl-C."""
        if self.viewer is not None:
            with self.viewer:
                self.viewer.play(self.run)


def view(request: ViewRequest, progress: Progress) -> ViewReport:
    """Prepare the view of a log: write its page, or open the viewer.

    Raises:
        BadRequest: the request or the log is wrong, or the viewer cannot be opened.
    """
    check_options(request)
    progress(0, 2, "reading")
    run = watch_log(request.log)
    progress(1, 2, "drawing")
    if request.html is not None:
        return ViewReport(request, run, save_page(run, request.html), None)
    return ViewReport(request, run, None, Viewer(run.scene, request.port, run.title, "use --html"))


def view_json(report: ViewReport) -> dict[str, Any]:
    """Return a view as a JSON document."""
    frames = report.run.frames
    return {
        "log": str(report.request.log),
        "html": None if report.request.html is None else str(report.request.html),
        "html_bytes": report.page_bytes,
        "address": None if report.viewer is None else report.viewer.address,
        "frames": len(frames.samples.time_s),
        "duration_s": float(frames.samples.time_s[-1] - frames.samples.time_s[0]),
        "events": len(report.run.events),
        "has_truth": frames.true is not None,
        "notes": list(report.run.notes),
    }


def view_table(report: ViewReport) -> None:
    """Print where the view is, and what it does not show."""
    console, times_s = plain_console(), report.run.frames.samples.time_s
    what = f"{pluralize(len(times_s), 'frame')} of {times_s[-1] - times_s[0]:.1f} s"
    if report.page_bytes is not None:
        console.print(
            f"page      {report.request.html}, {report.page_bytes / 1e6:.1f} MB, {what}", soft_wrap=True
        )
    if report.viewer is not None:
        console.print(f"playing   {what}; Ctrl-C ends it", soft_wrap=True)
    for note in report.run.notes:
        console.print(f"note      {note}", soft_wrap=True)
