"""`marsarm dictionary` as a user runs it."""

import json
import re
from dataclasses import fields, is_dataclass

import pytest
from typer.testing import CliRunner

from fsw.dictionary import evrs, faults
from marsarm.cli.app import app

RUN = CliRunner()


def out(*words: str, status: int = 0) -> str:
    result = RUN.invoke(app, ["dictionary", *words])
    assert result.exit_code == status, result.output
    return str(result.output)


def test_the_document_has_all_sections_and_nothing_else_is_printed() -> None:
    whole = json.loads(out("--json"))
    assert {name: bool(entries) for name, entries in whole.items()} == {
        "commands": True,
        "evrs": True,
        "packets": True,
        "parameters": True,
    }
    elbow = next(one for one in whole["parameters"] if one["name"] == "joints.elbow.speed_rad_s")
    assert (elbow["unit"], elbow["low"], elbow["high"]) == ("rad/s", 1e-3, 0.1)


@pytest.mark.parametrize("pattern", ["MoveTool", "movetool", "MOVE_TOOL"])
def test_a_command_is_found_by_either_name(pattern: str) -> None:
    part = json.loads(out(pattern, "--json"))
    assert [entry["name"] for entry in part["commands"]] == ["MoveTool"]
    assert part["evrs"] == part["packets"] == part["parameters"] == []


def has_current(kind: object) -> bool:
    return is_dataclass(kind) and any(field.name.endswith("current_A") for field in fields(kind))


def test_a_pattern_narrows_to_the_fields_that_match() -> None:
    part = json.loads(out("*current_A", "--json"))
    assert [(p["name"], [f["name"] for f in p["fields"]]) for p in part["packets"]] == [
        ("/sensors", ["current_A"])
    ]
    fits = {kind.__name__ for kind in (*vars(evrs).values(), *vars(faults).values()) if has_current(kind)}
    assert {e["name"] for e in part["evrs"]} == fits
    assert "OverCurrent" in fits


def test_people_read_a_table_that_marks_the_truth() -> None:
    text = out("/truth")
    assert "flight software never sees it" in " ".join(text.split())
    assert "kinetic_energy_J" in text


def test_the_markdown_has_a_row_for_every_parameter() -> None:
    names = [one["name"] for one in json.loads(out("--json"))["parameters"]]
    rows = re.findall(r"^\| (\S+) \|", out("--markdown"), re.MULTILINE)
    assert {name.replace("*", "\\*") for name in names} <= set(rows)


def test_a_pattern_that_matches_nothing_is_refused_with_what_was_meant() -> None:
    assert "did you mean OverCurrent?" in out("OverCurent", status=2)
    assert "did you mean /joint.motor_rad?" in out("/joint/moter_rad", status=2)


def test_without_a_similar_name_the_error_says_how_to_list_all() -> None:
    message = " ".join(out("nosuch", status=2).split())
    assert message == (
        "dictionary: nothing is called 'nosuch'; `marsarm dictionary` lists all there is, "
        "and a pattern is written as '*tilt*', where * stands for any letters"
    )


@pytest.mark.parametrize("pattern", ["/joint.motor_rad", "/joint/motor_rad", "/JOINT/motor_*d"])
def test_a_channel_is_found_in_either_spelling(pattern: str) -> None:
    (packet,) = json.loads(out(pattern, "--json"))["packets"]
    assert packet["name"] == "/joint"
    assert "motor_rad" in [one["name"] for one in packet["fields"]]
