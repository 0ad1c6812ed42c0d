"""Errors of a scenario file: all at once, with the path of the key and what would be right."""

import pytest

from sim.scenario.file import BadScenario, built_in_scenarios, load_scenario, parse_scenario
from tests.sim.scenario.bad import BAD, GOOD


def problems(text: str) -> tuple[str, ...]:
    with pytest.raises(BadScenario) as refused:
        parse_scenario(text, "test", "some/test.toml")
    assert str(refused.value).splitlines() == [f"some/test.toml: {one}" for one in refused.value.problems]
    return refused.value.problems


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_refused_with_its_key_and_what_would_be_right(case):
    right, wrong, expected = BAD[case]
    assert GOOD.count(right) >= 1
    found = problems(GOOD.replace(right, wrong, 1))
    assert any(one.startswith(expected) for one in found), found


def test_all_problems_are_told_at_once():
    edited = GOOD.replace("tilt_roll_deg", "tilt_rol_deg").replace('"elbow"', '"elbo"')
    edited = edited.replace("distance_mm = 100\n", "").replace('"placed"', '"palced"')
    assert [one.split(":")[0] for one in problems(edited)] == [
        "world.tilt_rol_deg",
        "command[3].distance_m or distance_mm",
        "command[4].joint",
        "check[2].type",
    ]


@pytest.mark.parametrize("lists", ["", "command = []\ncheck = []\n"])
def test_a_file_without_commands_and_checks_says_what_is_missing(lists):
    found = problems(f'title = "T"\nsummary = "S."\n{lists}')
    assert [one.split(";")[0] for one in found] == ["command: is missing", "check: is missing"]
    assert {one.split(":")[0] for one in problems("")} == {"title", "summary", "command", "check"}


def test_a_scenario_or_file_that_is_not_there_is_told(tmp_path):
    with pytest.raises(BadScenario, match=r"no such scenario; did you mean sampling\? there are bit-ex"):
        load_scenario("samplin")
    with pytest.raises(BadScenario, match=r"none\.toml: cannot be read .*No such file"):
        load_scenario(str(tmp_path / "none.toml"))


@pytest.mark.parametrize("name", built_in_scenarios())
def test_any_key_of_a_scenario_of_the_house_that_is_misspelt_is_found(name):
    lines = built_in_scenarios()[name].splitlines()
    for k, line in enumerate(lines):
        if " = " in line and line[:4] not in ("type", "# "):
            key = f"x{line.split(' = ')[0]}"
            found = problems("\n".join([*lines[:k], f"x{line}", *lines[k + 1 :]]))
            assert any(one.split(":")[0].endswith(key) for one in found), found
