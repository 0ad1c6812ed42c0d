"""Headless Chromium, driven by its own protocol over a pipe: open a page, evaluate in it, save a screenshot.

It needs no package. `apt-get install chromium` installs the browser; what needs it is skipped without it.

The campaign `view` measures the page that plays a run in it.
"""

import base64
import fcntl
import json
import os
import select
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, Self

from marsarm.runs.place import place
from marsarm.runs.request import PlaceRequest, RunFiles
from marsarm.view.page import save_page
from marsarm.view.watched_run import watch_log
from simgap.common.errors import BadRequest
from validation.campaigns import Context, Document

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome-headless-shell")
MISSING = "no Chromium on this machine; apt-get install chromium"
FLAGS = (
    *("--headless", "--no-sandbox", "--no-first-run"),
    *("--disable-quic", "--disable-sync", "--hide-scrollbars"),
    *("--disable-background-networking", "--disable-component-update", "--remote-debugging-pipe"),
    *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"),
)
"""Without a network, without a GPU, and on virtual machines."""
START = """
import os, sys
os.dup2(int(sys.argv[1]), 3)
os.dup2(int(sys.argv[2]), 4)
os.execv(sys.argv[3], sys.argv[3:])
"""
"""Program that becomes Chromium, with the protocol on descriptors 3 and 4."""
ANSWER_S = 120.0
PLAYS = "Boolean(window.player && player.drawn)"
"""True once the player of a run has drawn a frame."""
RESTS = f"{PLAYS} && player.calm > 1 && !player.isStale"
"""True once the player of a moment has drawn it with all pixels."""
LOADED = "document.readyState === 'complete' && location.protocol !== 'about:'"
"""True once a page without a player is there."""


def find_chromium() -> str | None:
    """Return the path of a Chromium, or None."""
    return next(filter(None, map(shutil.which, NAMES)), None)


LEAST_CONTRAST = 4.5
"""Of text, by WCAG 2.1, level AA."""
CONTRAST = """
(() => {
  const canvas = document.createElement("canvas").getContext("2d", {willReadFrequently: true});
  const parse = (colour) => {
    canvas.clearRect(0, 0, 1, 1);
    canvas.fillStyle = colour;
    canvas.fillRect(0, 0, 1, 1);
    return [...canvas.getImageData(0, 0, 1, 1).data];
  };
  const light = (colour) => colour.slice(0, 3).map((v) => v / 255)
    .map((v) => v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, k) => sum + v * [0.2126, 0.7152, 0.0722][k], 0);
  const behind = (node) => {  // a colour that lets light through lies over what is behind it
    const layers = [];
    for (let at = node; at && layers.at(-1)?.[3] !== 255; at = at.parentElement) {
      layers.push(parse(getComputedStyle(at).backgroundColor));
    }
    return layers.reduceRight((below, [r, g, b, a]) =>
      below.map((v, k) => v + (a / 255) * ([r, g, b][k] - v)), [255, 255, 255]);
  };
  let least = 21;
  for (const node of document.body.querySelectorAll(":not(script):not(style):not(noscript)")) {
    const hasText = [...node.childNodes].some((one) => one.nodeType === Node.TEXT_NODE && one.data.trim());
    if (!hasText || !node.getClientRects().length) continue;  // such as the title of a figure
    const style = getComputedStyle(node);
    const own = parse(node instanceof SVGElement ? style.fill : style.color);
    const [ink, paper] = [own, behind(node)].map(light);
    least = Math.min(least, (Math.max(ink, paper) + 0.05) / (Math.min(ink, paper) + 0.05));
  }
  return least;
})()
"""
"""Least contrast of any text of a page with what is behind it."""


class Browser:
    """Chromium with one page; a context manager."""

    def __init__(self) -> None:
        program = find_chromium()
        if program is None:
            raise FileNotFoundError(MISSING)
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        theirs_in, self._write = (_above_ten(fd) for fd in os.pipe())
        self._read, theirs_out = (_above_ten(fd) for fd in os.pipe())
        words = [sys.executable, "-c", START, str(theirs_in), str(theirs_out), program, *FLAGS]
        self._process = subprocess.Popen(
            [*words, f"--user-data-dir={self._folder.name}", "about:blank"],
            pass_fds=(theirs_in, theirs_out),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(theirs_in)
        os.close(theirs_out)
        self._number, self._bytes, self._session = 0, b"", None
        self.problems: list[str] = []
        """Exceptions and errors that the page reported."""
        self.requests: list[str] = []
        """Addresses that the page asked for."""
        target = self._ask("Target.createTarget", url="about:blank")["targetId"]
        self._session = self._ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self._ask(f"{domain}.enable")

    def open(
        self, address: str, width: int = 1400, height: int = 900, dark: bool = False, ready: str = PLAYS
    ) -> None:
        """Open a page in a window of this size, and wait until an expression in it is true."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self._ask("Emulation.setDeviceMetricsOverride", **size)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self._ask("Emulation.setEmulatedMedia", features=[scheme])
        self._ask("Page.navigate", url=address)
        until_s = time.monotonic() + ANSWER_S
        while not self.evaluate(ready):
            if time.monotonic() > until_s or self.problems:
                raise TimeoutError(f"the page is not ready: {self.problems}")
            time.sleep(0.1)

    def evaluate(self, script: str) -> Any:
        """Evaluate an expression in the page, wait for it if it is a promise, and return its value."""
        found = self._ask("Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in found:
            raise RuntimeError(json.dumps(found["exceptionDetails"])[:500])
        return found["result"].get("value")

    def save_screenshot(self, path: Path) -> None:
        """Save the window as PNG."""
        found = self._ask("Page.captureScreenshot", format="png")
        path.write_bytes(base64.b64decode(found["data"]))

    def _ask(self, method: str, **params: Any) -> Any:
        self._number += 1
        session = {} if self._session is None else {"sessionId": self._session}
        message = {"id": self._number, "method": method, "params": params, **session}
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._receive()
            if answer.get("id") == self._number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return answer["result"]
            self._note(answer)

    def _note(self, event: dict[str, Any]) -> None:
        method, params = event.get("method"), event.get("params", {})
        if method == "Runtime.exceptionThrown":
            self.problems.append(json.dumps(params["exceptionDetails"])[:500])
        if method == "Log.entryAdded" and params["entry"]["level"] == "error":
            self.problems.append(params["entry"]["text"])
        if method == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])

    def _receive(self) -> dict[str, Any]:
        while b"\0" not in self._bytes:
            if not select.select([self._read], [], [], ANSWER_S)[0]:
                raise TimeoutError(f"Chromium did not answer in {ANSWER_S:.0f} s")
            received = os.read(self._read, 1 << 20)
            if not received:
                raise RuntimeError("Chromium ended")
            self._bytes += received
        text, _, self._bytes = self._bytes.partition(b"\0")
        answer: dict[str, Any] = json.loads(text)
        return answer

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._write)
        os.close(self._read)
        self._process.terminate()
        self._process.wait()
        self._folder.cleanup()


def _above_ten(descriptor: int) -> int:
    """Return a copy of a descriptor with a number that no standard stream or protocol has."""
    copied = fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, 10)
    os.close(descriptor)
    return copied


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


def view(context: Context, log: Path | None = None) -> Document:
    """Measure the frames a second of the page that plays a run, without a GPU, and its size.

    It plays a log, by default a placement of as-built:7; the folder takes the pictures of docs/logs.md.
    """
    if find_chromium() is None:
        raise BadRequest(f"view: {MISSING}")
    with tempfile.TemporaryDirectory() as folder, Browser() as browser:
        if log is None:
            log = Path(folder) / "run.mcap"
            request = PlaceRequest(arm="as-built:7", tilt_pitch_deg=10.0, files=RunFiles(log=log))
            place(request, context.progress)
        page = Path(folder) / "run.html"
        size = save_page(watch_log(log), page)
        browser.open(page.as_uri())
        browser.evaluate(MEASURE % (1, SECONDS))  # the first frames compile shaders and upload shapes
        measured = {speed: browser.evaluate(MEASURE % (speed, SECONDS)) for speed in SPEEDS}
        shots = {} if context.out is None else {context.out / name: shot for name, shot in SHOTS.items()}
        for path, (width, height, dark, time_s, factor) in shots.items():
            moment = f"#t={time_s}&x={factor}&camera=all"
            browser.open(page.as_uri() + moment, width, height, dark, ready=RESTS)
            browser.save_screenshot(path)
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
