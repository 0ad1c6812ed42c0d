"""Errors of a scenario file: all at once, with line numbers and what would be right."""

import pytest

from sim.scenario.file import BadScenario, built_in_scenarios, load_scenario, parse_scenario
from tests.sim.scenario.bad import BAD, GOOD


def problems(text: str) -> tuple[tuple[int, str], ...]:
    with pytest.raises(BadScenario) as refused:
        parse_scenario(text, "test", "some/test.toml")
    expected = str(refused.value).splitlines()
    assert expected == [f"some/test.toml:{p.line}: {p.text}" for p in refused.value.problems]
    return tuple((p.line, p.text) for p in refused.value.problems)


def test_the_file_that_is_spoilt_here_is_good():
    assert len(parse_scenario(GOOD, "test", "test.toml").commands) == 4


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused_with_its_line_and_what_would_be_right(case):
    right, wrong, line, expected = BAD[case]
    assert GOOD.count(right) >= 1
    edited = GOOD.replace(right, wrong, 1)
    first = problems(edited)[0]
    assert first[0] == line
    assert expected in first[1]


def test_all_problems_are_told_at_once_in_the_order_of_their_lines():
    edited = GOOD.replace("tilt_roll_deg", "tilt_rol_deg").replace('"elbow"', '"elbo"')
    edited = edited.replace("distance_mm = 100\n", "").replace('"placed"', '"palced"')
    found = problems(edited)
    assert [line for line, _ in found] == [6, 29, 35, 46]
    assert [text.split(":")[0] for _, text in found] == [
        "tilt_rol_deg",
        "distance_m or distance_mm",
        "joint",
        "type",
    ]


def test_a_file_without_commands_and_checks_says_what_is_missing():
    found = problems('title = "T"\nsummary = "S."\n')
    assert [text.split(";")[0] for _, text in found] == ["check: is missing", "command: is missing"]


def test_lists_with_nothing_in_them_are_missing_too():
    found = problems('title = "T"\nsummary = "S."\ncommand = []\ncheck = []\n')
    assert [text.split(";")[0] for _, text in found] == ["check: is missing", "command: is missing"]


def test_an_empty_file_is_told_everything_that_is_missing():
    assert {text.split(":")[0] for _, text in problems("")} == {"title", "summary", "command", "check"}


@pytest.mark.parametrize("text", ["[" * 20000, "x = " + "[" * 20000, "x = 1" + "0" * 5000], ids=str.__len__)
def test_a_file_without_end_is_a_sentence_too(text):
    assert "is not TOML" in problems(text)[0][1]


def test_a_scenario_that_is_not_there_is_told_with_the_names_that_are():
    with pytest.raises(
        BadScenario, match="there is no such scenario; did you mean sampling\\? there are bit-ex"
    ):
        load_scenario("samplin")


def test_a_file_that_is_not_there_or_no_text_is_told(tmp_path):
    with pytest.raises(BadScenario, match=r"none\.toml: cannot be read .*No such file"):
        load_scenario(str(tmp_path / "none.toml"))
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(BadScenario, match=r"bytes\.toml: is not text in UTF-8"):
        load_scenario(str(tmp_path / "bytes.toml"))


@pytest.mark.parametrize("name", built_in_scenarios())
def test_any_key_of_a_scenario_of_the_house_that_is_misspelt_is_found_on_its_line(name):
    lines = built_in_scenarios()[name].splitlines()
    keys = [k for k, line in enumerate(lines) if " = " in line and line[:4] not in ("type", "# ")]
    for k in keys:
        edited = [*lines]
        edited[k] = "x" + edited[k]
        assert (k + 1) in [line for line, _ in problems("\n".join(edited))]
