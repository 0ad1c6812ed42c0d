"""Campaign of the page that plays a run, in headless Chromium."""

import tempfile
from pathlib import Path

from marsarm.runs.place import place
from marsarm.runs.request import PlaceRequest, RunFiles
from marsarm.view.page import save_page
from marsarm.view.watched_run import watch_log
from simgap.common.errors import BadRequest
from simgap.common.progress import Progress
from validation.browser import MISSING, Browser, find_chromium
from validation.campaigns import Context, Document

SECONDS = 5.0
SPEEDS = (1, 10, 50)
BOUND_FRAMES_S = 20.0
BOUND_BYTES = 5_000_000
MEASURE = """
new Promise((done) => {
  document.getElementById("speed").value = %d;
  player.seek(player.start + 0.3 * player.span);
  if (!player.playing) player.toggle();
  const [drawn, begun, time] = [player.drawn, performance.now(), player.time];
  const look = () => {
    const wall = (performance.now() - begun) / 1000;
    if (wall < %g) return requestAnimationFrame(look);
    if (player.playing) player.toggle();
    done([(player.drawn - drawn) / wall, (player.time - time) / wall]);
  };
  look();
})
"""
SHOTS = {
    "view.png": (1400, 900, False, 541.0, 1.0),
    "view-magnified.png": (1400, 900, False, 541.0, 20.0),
    "view-phone.png": (400, 860, True, 541.0, 1.0),
}
"""Width, height, dark mode, time and magnification of each picture of the docs."""


def campaign(context: Context, log: Path | None = None) -> Document:
    """Measure the frames a second of the page that plays a run, without a GPU, and its size.

    Args:
        context: Its folder takes the pictures of docs/view.md.
        log: The log to play; a placement of as-built:7 if there is none.
    """
    if find_chromium() is None:
        raise BadRequest(f"view: {MISSING}")
    with tempfile.TemporaryDirectory() as folder, Browser() as browser:
        log = log or record_placement(Path(folder) / "run.mcap", context.progress)
        page = Path(folder) / "run.html"
        size = save_page(watch_log(log), page)
        browser.open(page.as_uri())
        browser.evaluate(MEASURE % (1, SECONDS))  # the first frames compile shaders and upload shapes
        measured = {speed: browser.evaluate(MEASURE % (speed, SECONDS)) for speed in SPEEDS}
        if context.out is not None:
            take_pictures(browser, page, context.out)
    frames = {speed: frames_s for speed, (frames_s, _) in measured.items()}
    passed = min(frames.values()) >= BOUND_FRAMES_S and size <= BOUND_BYTES
    return {
        "page_bytes": size,
        "page_bytes_bound": BOUND_BYTES,
        "frames_per_s": {f"{speed}x": round(frames_s, 1) for speed, frames_s in frames.items()},
        "frames_per_s_bound": BOUND_FRAMES_S,
        "run_s_per_wall_s": {f"{speed}x": round(ratio, 2) for speed, (_, ratio) in measured.items()},
        "problems_of_the_page": browser.problems,
        "in_bounds": passed and not browser.problems,
    }


def record_placement(log: Path, progress: Progress) -> Path:
    """Record a placement of an as-built arm on a tilted rover."""
    place(PlaceRequest(arm="as-built:7", tilt_pitch_deg=10.0, files=RunFiles(log=log)), progress)
    return log


def take_pictures(browser: Browser, page: Path, folder: Path) -> None:
    """Take the pictures of the docs."""
    for name, (width, height, dark, time_s, factor) in SHOTS.items():
        browser.open(page.as_uri(), width, height, dark)
        browser.evaluate(
            f"document.getElementById('magnify').value = Math.log({factor});"
            f"player.seek({time_s}); player.draw()"
        )
        browser.save_screenshot(folder / name)
