"""View of a run in the browser: a page that needs no server."""

import base64
import gzip
import html
import json
import os
import sys
import webbrowser
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from marsarm.common.options import ViewRequest
from marsarm.view.scene import looks_json
from marsarm.view.watched_run import Plot, WatchedRun, make_plots, watch_log
from simgap.common.console import pluralize
from simgap.common.files import atomic_write
from simgap.common.options import check_options
from simgap.common.progress import GUESS, Progress

SCRIPTS: Final = ("scene.js", "painter.js", "plots.js", "player.js")
LOOK_AT: Final = np.array([0.5, 0.5, 0.25])
"""Point at which the camera looks, as shares of the box around the trail: the surface is at its bottom."""


def save_page(run: WatchedRun, path: Path) -> int:
    """Write a page, and return its size in bytes; BadOutput if the file cannot be written."""
    page = make_page(run)
    with atomic_write(path, "html") as file:
        file.write(page)
    return len(page)


def make_page(run: WatchedRun) -> bytes:
    """Make a page; the same run gives the same bytes."""
    plots = make_plots(run.frames)
    packed, about = _pack(_arrays(run, plots))
    read = {
        name: files("marsarm.view").joinpath("page", name).read_text(encoding="utf-8")
        for name in ("page.html", "style.css", *SCRIPTS)
    }
    text = Template(read["page.html"]).substitute(
        title=html.escape(run.title),
        style=read["style.css"],
        player="".join(read[name] for name in SCRIPTS),
        run=json.dumps({**_document(run, plots), "arrays": about}, allow_nan=False).replace("<", "\\u003c"),
        data=base64.b64encode(packed).decode(),
    )
    return text.encode()


def _document(run: WatchedRun, plots: tuple[Plot, ...]) -> dict[str, Any]:
    """Return what the player needs besides arrays."""
    frames = run.frames
    low_m, high_m = frames.p_m[:, -1].min(axis=0), frames.p_m[:, -1].max(axis=0)
    starts = np.cumsum(
        [(0, 0), *((len(p.triangles.vertices_m), len(p.triangles.faces)) for p in run.scene.parts)], axis=0
    )
    return {
        "frames": len(frames.samples.time_s),
        "bodies": frames.p_m.shape[1],
        "carriers": run.scene.carriers,
        "looks": looks_json(),
        "target": (low_m + LOOK_AT * (high_m - low_m)).astype(float).tolist(),
        "modes": frames.samples.mode_names,
        "facts": run.facts,
        "notes": run.notes,
        "events": [(event.time_s, int(event.severity), event.text) for event in run.events],
        "parts": [
            {
                "carrier": part.carrier,
                "rgb": part.rgb,
                "is_ground": part.is_ground,
                "vertices": (int(start[0]), len(part.triangles.vertices_m)),
                "faces": (int(start[1]), len(part.triangles.faces)),
            }
            for part, start in zip(run.scene.parts, starts, strict=False)
        ],
        "plots": [
            {
                "title": plot.title,
                "unit": plot.unit,
                "labels": list(plot.values),
                "series": [f"{plot.title} {label}" for label in plot.values],
            }
            for plot in plots
        ],
    }


def _arrays(run: WatchedRun, plots: tuple[Plot, ...]) -> dict[str, NDArray[Any]]:
    frames, parts = run.frames, run.scene.parts
    arrays: dict[str, NDArray[Any]] = {
        "time": frames.samples.time_s,
        "p": frames.p_m,
        "q": frames.q,
        "believed": frames.believed,
        "force": frames.force_N,
        "trail start": frames.trail_start,
        "vertices": np.vstack([part.triangles.vertices_m for part in parts]),
        "faces": np.vstack([part.triangles.faces for part in parts]),
    }
    error_m = frames.tool_error_m
    if frames.true is not None and error_m is not None:
        arrays |= {"true": frames.true, "tool error": 1e3 * error_m}
    for plot in plots:
        arrays |= {f"{plot.title} {label}": values for label, values in plot.values.items()}
    return arrays


def _pack(arrays: Mapping[str, NDArray[Any]]) -> tuple[bytes, list[tuple[str, str, int, int]]]:
    """Compress arrays of 4-byte numbers, and return name, type, start in bytes and length of each."""
    about, data = [], b""
    for name, values in arrays.items():
        kind = "u4" if values.dtype.kind == "u" else "f4"
        about.append((name, kind, len(data), values.size))
        data += np.ascontiguousarray(values, f"<{kind}").tobytes()
    return gzip.compress(data, mtime=0), about


@dataclass(frozen=True, slots=True, eq=False)
class ViewReport:
    """View of a log."""

    request: ViewRequest
    page: Path
    page_bytes: int
    run: WatchedRun
    is_replaced: bool
    """True if the page is in place of an older one."""


def view(request: ViewRequest, progress: Progress) -> ViewReport:
    """Write the page of a log; BadRequest if something is wrong."""
    check_options(request)
    page = request.html or Path(f"{request.log.stem}.html")
    progress(0.0, GUESS, "reading")
    run = watch_log(request.log)
    run = replace(run, title=run.title or request.log.name, facts=(("log", request.log.name), *run.facts))
    progress(0.5, GUESS, "drawing")
    is_replaced = page.exists()
    return ViewReport(request, page, save_page(run, page), run, is_replaced)


def view_document(report: ViewReport) -> dict[str, Any]:
    """Collect where the page is, and what it shows."""
    frames = report.run.frames
    return {
        "log": report.request.log,
        "html": report.page,
        "html_bytes": report.page_bytes,
        "frames": len(frames.samples.time_s),
        "duration_s": frames.samples.time_s[-1] - frames.samples.time_s[0],
        "events": len(report.run.events),
        "has_truth": frames.true is not None,
        "notes": report.run.notes,
    }


def view_parts(report: ViewReport) -> list[str]:
    """Say where the page is, and what it does not show."""
    times_s = report.run.frames.samples.time_s
    what = f"{pluralize(len(times_s), 'frame')} of {times_s[-1] - times_s[0]:.1f} s"
    older = ", in place of an older one" if report.is_replaced else ""
    return [
        f"page      {report.page}{older}, {report.page_bytes / 1e6:.1f} MB, {what}",
        *(f"note      {note}" for note in report.run.notes),
    ]


OWN_SCREEN: Final = ("darwin", "win32")
"""Platforms on which a browser needs no variable to find the screen."""


@dataclass(frozen=True, slots=True)
class OpenedPage:
    """Page that is opened when it is played."""

    path: Path

    def play(self) -> None:
        """Open the page in the browser, or say where it is if there is no display or no browser."""
        has_display = sys.platform in OWN_SCREEN or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))
        is_open = has_display and webbrowser.open(self.path.resolve().as_uri())
        what = "opened in the browser" if is_open else "there is no display here; open it in any browser"
        print(f"{self.path}: {what}", file=sys.stderr)
