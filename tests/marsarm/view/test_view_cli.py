"""`marsarm view`, `--view` and `--movie`: what is written, and what is refused in one sentence."""

import importlib.util
import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.request
import webbrowser
from dataclasses import replace

import numpy as np
import pytest

from helpers.marks import slow_but
from marsarm.view import server
from marsarm.view.page import OpenedPage
from marsarm.view.scene import TRAIL_STEP_M
from marsarm.view.server import LiveView
from simgap.common.errors import BadRequest
from tests.marsarm.command import ROOT, marsarm
from tests.marsarm.view.lab import ARM, TILTED, records_of, start_loop

needs_viser = pytest.mark.skipif(
    importlib.util.find_spec("viser") is None, reason="viser is not installed; pip install 'marsarm[view]'"
)


def test_a_page_is_written_and_reported(log, tmp_path):
    ran = marsarm(tmp_path, "view", str(log), "--html", "run.html", "--json")
    assert ran.returncode == 0, ran.stderr
    document = json.loads(ran.stdout)
    assert document["html_bytes"] == (tmp_path / "run.html").stat().st_size
    assert document["has_truth"]
    assert document["address"] is None
    table = marsarm(tmp_path, "view", str(log), "--html", "run.html")
    assert "page      run.html" in table.stdout


@pytest.mark.parametrize(("has_browser", "said"), [(True, "opened in the browser"), (False, "no display")])
def test_a_page_is_opened_where_there_is_a_display(tmp_path, monkeypatch, capsys, has_browser, said):
    asked = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(webbrowser, "open", lambda address: asked.append(address) or has_browser)
    OpenedPage(tmp_path / "run.html").play()
    assert asked == [(tmp_path / "run.html").as_uri()]
    assert said in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", [("place", "--view", "--no-picture"), ("hardstop", "--joint", "wrist", "--view")]
)
def test_without_viser_nothing_moves_and_the_sentence_names_the_package(tmp_path, monkeypatch, words):
    monkeypatch.setitem(sys.modules, "viser", None)
    ran = marsarm(tmp_path, *words)
    assert ran.returncode == 2
    assert "pip install 'marsarm[view]', or leave out --view" in ran.stderr


def test_without_pyav_an_mp4_is_refused_before_anything_moves(tmp_path, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "av" else find(name))
    ran = marsarm(tmp_path, "place", "--movie", "run.mp4", "--no-picture")
    assert ran.returncode == 2
    assert "PyAV is missing; pip install 'marsarm[movie]', or name a .gif" in ran.stderr


@needs_viser
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_the_viewer_answers_on_loopback_only(run):
    with server.Viewer(run.scene, _free_port(), run.title, "use --html") as viewer:
        assert viewer.address.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(viewer.address, timeout=10) as page:
            assert page.status == 200
        port = int(viewer.address.rpartition(":")[2])
        others = {address[4][0] for address in socket.getaddrinfo(socket.gethostname(), port, socket.AF_INET)}
        for other in others - {"127.0.0.1"}:
            with pytest.raises(OSError, match="refused"):
                socket.create_connection((other, port), timeout=2).close()
        for time_s in (0.0, 1.5, 99.0):
            viewer.draw(run.frames, time_s, run.events, run.frames.trail(time_s))


@needs_viser
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_live_view_follows_a_run_and_plays_it_after(monkeypatch):
    played = []
    monkeypatch.setattr(server.Viewer, "play", lambda self, run: played.append(run))
    view = LiveView("a run", TILTED, ARM, ())
    for record in records_of(start_loop(ARM, TILTED)):
        view.watch(record)
    view.play()
    (run,) = played
    assert run.frames.true is not None
    assert [event.text for event in run.events]


@needs_viser
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_the_live_trail_begins_anew_with_another_tool_and_with_another_run(monkeypatch):
    monkeypatch.setattr("marsarm.view.server.DRAW_PERIOD_S", 0.0)
    trails = []
    monkeypatch.setattr(
        server.Viewer, "draw", lambda self, frames, time_s, events, trail: trails.append(trail)
    )
    records = list(records_of(start_loop(ARM, TILTED)))
    half = len(records) // 2
    pose = next(record.outputs.tool for record in records if record.outputs.tool is not None)
    with LiveView("a run", TILTED, ARM, ()) as view:
        for k, record in enumerate((*records, *records)):
            tool = replace(pose, tool=2 if half <= k < len(records) else 0)
            view.watch(replace(record, outputs=replace(record.outputs, tool=tool)))
    lengths = [len(trail.rigid_m) for trail in trails]
    begins = [k for k, length in enumerate(lengths) if length == 1]
    assert len(begins) == 3, "the run, the other tool, and the next run with its own first tool"
    assert begins[1] == pytest.approx(len(trails) / 4, abs=2)
    assert begins[2] == pytest.approx(len(trails) / 2, abs=2)
    steps_m = np.linalg.norm(np.diff(trails[-1].rigid_m[:-1], axis=0), axis=1)
    assert (steps_m > TRAIL_STEP_M).all(), "what does not move adds no point"


def read_until(stream, last):
    """Read lines until this one; the first line only if it is empty."""
    lines = [stream.readline()]
    while last and lines[-1] != last:
        lines.append(stream.readline())
    return "".join(lines)


@needs_viser
@pytest.mark.parametrize("words", slow_but([[], ["--json"]], ["--json"]))
def test_ctrl_c_closes_the_viewer_with_the_status_of_the_run(log, tmp_path, words):
    command = [sys.executable, "-c", "from marsarm.cli.app import main; main()", "view", str(log), *words]
    port = ("--port", str(_free_port()))
    env = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "ignore"}
    with subprocess.Popen(
        [*command, *port], cwd=tmp_path, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as ran:
        last = "}\n" if words else ""
        printed = read_until(ran.stdout, last)  # it comes while the viewer serves, also into a pipe
        time.sleep(1.0)
        ran.send_signal(signal.SIGINT)
        rest, errors = ran.communicate(timeout=60)
    assert ran.returncode == 0, errors
    assert errors.splitlines()[-1] == "viewer    closed"
    assert errors.count("http://127.0.0.1:") == 1
    assert rest == ""
    if words:
        assert json.loads(printed)["address"] in errors
    else:
        assert printed.startswith("playing   ")


@needs_viser
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_run_that_does_not_begin_stops_its_viewer(tmp_path, monkeypatch):
    stopped, stop = [], server.Viewer.stop
    monkeypatch.setattr(server.Viewer, "stop", lambda self: stopped.append(stop(self)))

    def fail(*_):
        raise BadRequest("no hardstop")

    monkeypatch.setattr("marsarm.runs.place.initialise", fail)
    ran = marsarm(tmp_path, "place", "--view", "--no-picture")
    assert ran.returncode == 2
    assert "no hardstop" in ran.stderr
    assert len(stopped) == 1


@needs_viser
def test_without_a_free_port_the_sentence_says_what_to_do_instead(tmp_path, monkeypatch, log):
    import viser

    def refuse(**_):
        raise OSError("all in use")

    monkeypatch.setattr(viser, "ViserServer", refuse)
    ran = marsarm(tmp_path, "hardstop", "--joint", "wrist", "--view")
    assert (ran.returncode, ran.stdout) == (2, "")
    assert ran.stderr.strip().endswith("no port from 8080 on can be opened (all in use); leave out --view")
    ran = marsarm(tmp_path, "view", str(log))
    assert ran.stderr.strip().endswith("no port from 8080 on can be opened (all in use); use --html")


def test_events_are_told_with_the_state_at_a_time(run):
    text = server.describe(run.frames, run.frames.samples.time_s[-1], run.events)
    assert "tool error" in text
    assert run.events[-1].text in text


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])
