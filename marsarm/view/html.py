"""Page that plays a run without a server: one file with scene, frames and player."""

import base64
import gzip
import html
import json
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from marsarm.view.looks import looks_json
from marsarm.view.plots import Plot, make_plots
from marsarm.view.watched_run import WatchedRun
from simgap.common.files import atomic_write

LOOK_AT: Final = np.array([0.5, 0.5, 0.25])
"""Point at which the camera looks, as shares of the box around the trail: the surface is at its bottom."""


def save_page(run: WatchedRun, path: Path) -> int:
    """Write a page, and return its size in bytes.

    Raises:
        BadOutput: the file cannot be written.
    """
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
        for name in ("page.html", "style.css", "scene.js", "player.js")
    }
    text = Template(read["page.html"]).substitute(
        title=html.escape(run.title),
        style=read["style.css"],
        player=read["scene.js"] + read["player.js"],
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
