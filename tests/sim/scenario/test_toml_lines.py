"""Line numbers of values in a TOML file."""

import random
import tomllib

import pytest

from sim.scenario.file import built_in_scenarios
from sim.scenario.toml_lines import TomlPath, find_lines

TEXT = '''\
# a comment with [brackets] = and "quotes"
title = "one"   # and one behind it
many = [
    1,
    # a comment in a list ]
    [2, 3], {x = 4, "y z" = 5},
]
words = """
[no.table]
key = 1 \\""" still "" text
"""
raw = \'\'\'
= ] } """\'\'\'

[world.surface]
position_m = [1.0,
  2.0, 3.0]
a."b.c".d = 1979-05-27 07:32:00

[[command]]
type = "A"
[[command]]
type = 'B'  # ] }
[command.inner]
x = true
[[command.parts]]
y = {}
[[command.parts]]
y = []
[ "quoted key" . x ]
z = -inf
'''

WHERE: dict[TomlPath, int] = {
    ("title",): 2,
    ("many",): 3,
    ("many", 0): 4,
    ("many", 1): 6,
    ("many", 1, 1): 6,
    ("many", 2, "x"): 6,
    ("many", 2, "y z"): 6,
    ("words",): 8,
    ("raw",): 12,
    ("world", "surface"): 15,
    ("world", "surface", "position_m"): 16,
    ("world", "surface", "position_m", 0): 16,
    ("world", "surface", "position_m", 2): 17,
    ("world", "surface", "a"): 18,
    ("world", "surface", "a", "b.c", "d"): 18,
    ("command",): 20,
    ("command", 0): 20,
    ("command", 0, "type"): 21,
    ("command", 1): 22,
    ("command", 1, "type"): 23,
    ("command", 1, "inner"): 24,
    ("command", 1, "inner", "x"): 25,
    ("command", 1, "parts", 0): 26,
    ("command", 1, "parts", 0, "y"): 27,
    ("command", 1, "parts", 1): 28,
    ("command", 1, "parts", 1, "y"): 29,
    ("quoted key", "x", "z"): 31,
}


def places_of(value, place=()):
    """List every key, table and element of a parsed file."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        yield (*place, key)
        yield from places_of(item, (*place, key))


@pytest.mark.parametrize("place", WHERE)
def test_every_value_has_its_line(place):
    assert find_lines(TEXT)[place] == WHERE[place]


@pytest.mark.parametrize(
    "text", [TEXT, *built_in_scenarios().values()], ids=["a bit of everything", *built_in_scenarios()]
)
def test_whatever_the_parser_finds_has_a_line_and_nothing_else_has(text):
    found = find_lines(text)
    wanted = set(places_of(tomllib.loads(text)))
    assert set(found) == wanted | {()}
    assert all(1 <= line <= text.count("\n") + 1 for line in found.values())


def test_windows_line_ends_count_once():
    assert find_lines(TEXT.replace("\n", "\r\n")) == find_lines(TEXT)


@pytest.mark.parametrize("seed", range(20))
def test_random_tables_with_comments_and_blank_lines_are_found_where_they_were_written(seed):
    rng = random.Random(seed)
    text, wanted = "", {}
    values = ["1", '"#"', "[1, 2]", "{a = [1], b = '}'}", '"""x\n[y]\nz = 1"""', "[\n1,\n2, # ]\n]"]
    for table in range(rng.randint(1, 6)):
        text += "\n" * rng.randint(0, 2) + "# [[no]]\n" * rng.randint(0, 1)
        wanted["t", table] = text.count("\n") + 1
        text += f"[[t]]{' # table' * rng.randint(0, 1)}\n"
        for key in range(rng.randint(0, 4)):
            wanted["t", table, f"k{key}"] = text.count("\n") + 1
            text += f"{' ' * rng.randint(0, 2)}k{key}{' ' * rng.randint(0, 2)}= {rng.choice(values)}\n"
    found = find_lines(text)
    assert {place: found[place] for place in wanted} == wanted
