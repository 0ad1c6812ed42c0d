"""`marsarm view`, `--view` and `--movie`: what is written, and what is refused in one sentence."""

import importlib.util
import json
import socket
import sys
import urllib.request

import pytest

from ground.view import server
from ground.view.live import LiveView
from tests.ground.command import marsarm
from tests.ground.view.lab import ARM, TILTED, records_of, start_loop

needs_viser = pytest.mark.skipif(
    importlib.util.find_spec("viser") is None, reason="viser is not installed; pip install 'marsarm[view]'"
)
needs_av = pytest.mark.skipif(
    importlib.util.find_spec("av") is None, reason="PyAV is not installed; pip install 'marsarm[movie]'"
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


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("none.mcap",), "none.mcap"),
        (("{log}", "--html", "run.htm"), "must end in .html"),
        (("{log}", "--html", "nowhere/run.html"), "there is no folder"),
        (("{log}", "--port", "80"), "port: 80 is not within 1024 .. 65535"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(log, tmp_path, words, complaint):
    ran = marsarm(tmp_path, "view", *(word.format(log=log) for word in words))
    assert ran.returncode == 2
    assert complaint in ran.stderr
    assert len(ran.stderr.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "words", [("place", "--view", "--no-picture"), ("hardstop", "--joint", "wrist", "--view")]
)
def test_without_viser_nothing_moves_and_the_sentence_names_the_package(tmp_path, monkeypatch, words):
    monkeypatch.setitem(sys.modules, "viser", None)
    ran = marsarm(tmp_path, *words)
    assert ran.returncode == 2
    assert "pip install 'marsarm[view]'" in ran.stderr


def test_without_pyav_an_mp4_is_refused_before_anything_moves(tmp_path, monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "av" else find(name))
    ran = marsarm(tmp_path, "place", "--movie", "run.mp4", "--no-picture")
    assert ran.returncode == 2
    assert "PyAV is missing; pip install 'marsarm[movie]', or name a .gif" in ran.stderr


@needs_viser
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_the_viewer_answers_on_loopback_only(run):
    viewer = server.Viewer(run.scene, _free_port(), run.title)
    try:
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
    finally:
        viewer.stop()


@needs_viser
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_live_view_follows_a_run_and_plays_it_after(monkeypatch):
    played = []
    monkeypatch.setattr(server.Viewer, "play", lambda self, run: played.append(run))
    view = LiveView("a run", TILTED, ARM, ())
    try:
        for record in records_of(start_loop(ARM, TILTED)):
            view.watch(record)
        view.play()
    finally:
        view.stop()
    (run,) = played
    assert run.frames.true is not None
    assert [event.text for event in run.events]


def test_events_are_told_with_the_state_at_a_time(run):
    text = server.describe(run.frames, run.frames.samples.time_s[-1], run.events)
    assert "tool error" in text
    assert run.events[-1].text in text


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])
