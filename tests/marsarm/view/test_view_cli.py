"""`marsarm view`: what is written and opened."""

import json
import webbrowser

import pytest

from marsarm.view.page import OpenedPage
from tests.marsarm.command import marsarm


def test_a_page_is_written_and_reported(log, tmp_path):
    ran = marsarm(tmp_path, "view", str(log), "--html", "run.html", "--json")
    assert ran.returncode == 0, ran.stderr
    document = json.loads(ran.stdout)
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
