"""Frames a second of the page that plays a run, in headless Chromium without a GPU, and its size.

Prints JSON; with `--shots DIR`, takes the pictures of docs/view.md. Without Chromium it says so, status 0.
"""

import argparse
import json
import sys
import tempfile
from pathlib import Path

from marsarm.runs.place import place
from marsarm.runs.request import PlaceRequest, RunFiles
from marsarm.view.page import save_page
from marsarm.view.watched_run import watch_log
from simgap.common.progress import show_progress
from validation.browser import MISSING, Browser, find_chromium

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


def main(words: list[str]) -> int:
    """Measure, print, and return the exit status."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--log", type=Path, help="a log to play; a placement of as-built:7 if not given")
    options.add_argument("--shots", type=Path, help="folder for the pictures of the docs")
    given = options.parse_args(words)
    if find_chromium() is None:
        print(f"view: {MISSING}", file=sys.stderr)
        return 0
    with tempfile.TemporaryDirectory() as folder, Browser() as browser:
        log = given.log or record_placement(Path(folder) / "run.mcap")
        page = Path(folder) / "run.html"
        size = save_page(watch_log(log), page)
        browser.open(page.as_uri())
        browser.evaluate(MEASURE % (1, SECONDS))  # the first frames compile shaders and upload shapes
        measured = {speed: browser.evaluate(MEASURE % (speed, SECONDS)) for speed in SPEEDS}
        if given.shots is not None:
            take_pictures(browser, page, given.shots)
    frames = {speed: frames_s for speed, (frames_s, _) in measured.items()}
    passed = min(frames.values()) >= BOUND_FRAMES_S and size <= BOUND_BYTES
    document = {
        "page_bytes": size,
        "page_bytes_bound": BOUND_BYTES,
        "frames_per_s": {f"{speed}x": round(frames_s, 1) for speed, frames_s in frames.items()},
        "frames_per_s_bound": BOUND_FRAMES_S,
        "run_s_per_wall_s": {f"{speed}x": round(ratio, 2) for speed, (_, ratio) in measured.items()},
        "problems_of_the_page": browser.problems,
        "passed": passed and not browser.problems,
    }
    print(json.dumps(document, indent=2))
    return 0 if document["passed"] else 3


def record_placement(log: Path) -> Path:
    """Record a placement of an as-built arm on a tilted rover."""
    request = PlaceRequest(arm="as-built:7", tilt_pitch_deg=10.0, files=RunFiles(log=log))
    with show_progress() as progress:
        place(request, progress)
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


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
