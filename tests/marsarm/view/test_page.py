"""The page that plays a run: complete, small, and drawn as the frames say; `marsarm view` opens it."""

import base64
import gzip
import json
import re
import shutil
import subprocess
import webbrowser
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from marsarm.view.page import OpenedPage, make_page, save_page
from tests.marsarm.command import marsarm, marsarm_json
from tests.marsarm.view.lab import arm_at, between

MOST_BYTES = 5_000_000
TIMES_S = (0.0, 0.4, 1.1, 2.9, 99.0)
FACTORS = (1.0, 7.0)
SCENE = files("marsarm.view").joinpath("page", "scene.js").read_text(encoding="utf-8")

DRAWN_TWICE_MORE = """
(() => { document.getElementById("speed").value = 1; player.seek(player.start);
  player.playing || player.toggle();
  const until = player.drawn + 2;
  return new Promise((done) => {
    const look = () => player.drawn >= until ? done(true) : requestAnimationFrame(look);
    look();
  });
})()
"""

needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="no Node.js on this machine")


def contents(page):
    """Return the document and the arrays of a page."""
    text = page.decode()
    document = json.loads(
        re.search(r'<script type="application/json" id="run">(.*?)</script>', text, re.S)[1]
    )
    packed = re.search(r'<script type="text/plain" id="data">(.*?)</script>', text, re.S)[1]
    data = gzip.decompress(base64.b64decode(packed))
    return document, {
        name: np.frombuffer(data, f"<{kind}", size, at) for name, kind, at, size in document["arrays"]
    }


def test_a_page_holds_the_frames_events_and_plots_of_its_run(run):
    document, arrays = contents(make_page(run))
    frames = run.frames
    assert arrays["true"].reshape(frames.true.shape) == pytest.approx(frames.true)
    assert arrays["q"].reshape(frames.q.shape) == pytest.approx(frames.q)
    assert [text for _, _, text in document["events"]] == [event.text for event in run.events]
    assert len(document["events"]) > 2
    titles = [plot["title"] for plot in document["plots"]]
    assert titles == ["joint angle", "true less believed angle", "motor current", "contact force"]
    assert all(
        len(arrays[name]) == document["frames"] for plot in document["plots"] for name in plot["series"]
    )


def test_a_page_is_small_asks_for_nothing_and_is_the_same_each_time(run):
    page = make_page(run)
    assert len(page) < MOST_BYTES
    assert page == make_page(run)
    assert not re.search(rb"(?:src|href)\s*=|https?://|\bimport\b\s*[({'\"]", page)


def test_a_title_cannot_break_out_of_the_page(run):
    evil = "</script><script>alert(1)</script>"
    page = make_page(replace(run, title=evil, notes=(evil,))).decode()
    assert "<script>alert" not in page
    document, _ = contents(page.encode())
    assert document["notes"] == [evil]


@needs_node
def test_the_player_computes_the_poses_of_the_frames(run, tmp_path):
    document, arrays = contents(make_page(run))
    given = {"run": document, "arrays": {name: values.tolist() for name, values in arrays.items()}}
    (tmp_path / "given.json").write_text(json.dumps(given))
    script = (
        SCENE
        + """
    const given = JSON.parse(require("fs").readFileSync(process.argv[2]));
    const motion = new Motion(given.run, given.arrays);
    const poses = [], bodies = [...Array(given.run.bodies).keys()];
    for (const time of JSON.parse(process.argv[3])) for (const factor of JSON.parse(process.argv[4]))
      for (const which of ["true", "believed"])
        poses.push(bodies.map((body) => motion.pose(which, body, motion.at(time), factor).flat()));
    console.log(JSON.stringify(poses));
    """
    )
    (tmp_path / "player.js").write_text(script)
    words = ["node", "player.js", "given.json", json.dumps(TIMES_S), json.dumps(FACTORS)]
    done = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True)
    poses = iter(json.loads(done.stdout))
    frames = run.frames
    for time_s in TIMES_S:
        for factor in FACTORS:
            for offset in (frames.true, frames.believed):
                played = np.array(next(poses))
                p_m, q = arm_at(frames, offset, time_s, factor)
                assert played[:, :3] == pytest.approx(p_m, abs=1e-6)
                assert np.abs(np.sum(played[:, 3:] * q, axis=1)) == pytest.approx(1.0, abs=1e-6)


def test_a_page_plays_from_a_file_at_every_speed(run, browser, tmp_path):
    page = tmp_path / "run.html"
    save_page(run, page)
    browser.open(page.as_uri(), 700, 500)
    assert browser.evaluate("[...document.getElementById('speed').options].map((o) => o.value)") == [
        *("1", "2", "5", "10", "20", "50")
    ]
    for speed in (1, 2, 5, 10, 20, 50):
        begun, ended = browser.evaluate(
            f"document.getElementById('speed').value = {speed}; player.playing || player.toggle();"
            "player.seek(player.start); player.advance(0.01); [player.start, player.time]"
        )
        assert ended - begun == pytest.approx(0.01 * speed)
    assert browser.evaluate(DRAWN_TWICE_MORE)
    browser.evaluate("player.seek(player.end); player.advance(1)")
    assert browser.evaluate("document.getElementById('play').textContent") == "Play", "it stops at the end"
    assert all(address.startswith(("file:", "about:", "data:")) for address in browser.requests)
    assert browser.problems == []


def test_plots_events_and_camera_follow_what_the_user_does(run, browser, tmp_path):
    page = tmp_path / "run.html"
    save_page(run, page)
    browser.open(page.as_uri() + "#t=2&x=20&camera=tool", 1400, 900)
    assert browser.evaluate("[player.playing, player.time, Math.round(player.factor)]") == [False, 2, 20]
    assert browser.evaluate("player.orbit.distance") == pytest.approx(1.3)
    counts = browser.evaluate("[[0.8, 9.2], [-1, 1]].map((ends) => ticksBetween(...ends).length)")
    assert all(2 <= count <= 5 for count in counts)
    shown = browser.evaluate("""(() => { const plot = player.plots[0];
      player.show(1, 3); player.point(1.5); player.draw(); plot.choose(2, true);
      return [player.range, plot.shown, plot.labels[0].value.textContent]; })()""")
    angle_deg = np.degrees(between(run.frames, run.frames.samples.believed_rad[0], 1.5))
    assert shown[:2] == [[1, 3], [False, False, True, False, False]]
    assert float(shown[2]) == pytest.approx(angle_deg, abs=0.1)
    body_of_line = "player.painter.gl.getVertexAttrib(2, player.painter.gl.CURRENT_VERTEX_ATTRIB)[3]"
    assert browser.evaluate(body_of_line) == 0, "the trail does not ride on a link"
    last = len(run.events) - 1
    seen = browser.evaluate(f"""(() => {{ player.seek(player.end); player.draw();
      const list = byId("events").getBoundingClientRect();
      const button = player.rows[{last}][1].getBoundingClientRect();
      return button.top >= list.top && button.bottom <= list.bottom + 1; }})()""")
    assert seen, "the present event is in view"
    assert browser.problems == []


@pytest.mark.slow
@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [400, 1400])
def test_a_page_fits_the_screen_and_draws_the_arm(run, browser, tmp_path, width, dark):
    page = tmp_path / "run.html"
    save_page(run, page)
    browser.open(page.as_uri(), width, 900, dark)
    assert browser.evaluate("document.documentElement.scrollWidth") <= width
    colours = browser.evaluate("""(() => {
      player.draw();
      const gl = player.painter.gl, { width, height } = gl.canvas;
      const pixels = new Uint8Array(4 * width * height);
      gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
      return new Set(new Uint32Array(pixels.buffer)).size; })()""")
    assert colours > 500
    assert browser.problems == []


def test_a_page_is_written_and_reported(log, tmp_path):
    document = marsarm_json(tmp_path, "view", str(log), "--html", "run.html")
    assert document["html_bytes"] == (tmp_path / "run.html").stat().st_size
    assert document["has_truth"]
    table = marsarm(tmp_path, "view", str(log), "--html", "run.html")
    assert "page      run.html, in place of an older one" in table.stdout
    assert table.stderr == ""


def test_without_a_name_the_page_has_that_of_the_log_and_is_opened(log, tmp_path, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    ran = marsarm(tmp_path, "view", str(log))
    assert (ran.returncode, [one.name for one in tmp_path.iterdir()]) == (0, [f"{log.stem}.html"])
    assert "older" not in ran.stdout
    assert "run.html: there is no display here; open it in any browser" in ran.stderr


@pytest.mark.parametrize(("has_browser", "said"), [(True, "opened in the browser"), (False, "no display")])
def test_a_page_is_opened_where_there_is_a_display(tmp_path, monkeypatch, capsys, has_browser, said):
    asked = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(webbrowser, "open", lambda address: asked.append(address) or has_browser)
    OpenedPage(tmp_path / "run.html").play()
    assert asked == [(tmp_path / "run.html").as_uri()]
    assert said in capsys.readouterr().err
