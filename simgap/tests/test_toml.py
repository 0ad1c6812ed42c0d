"""The one reader and the one writer of TOML, and the units that files may name."""

import math
import os
import tomllib
from dataclasses import dataclass
from pathlib import Path

import pytest
from pydantic import ValidationError

from simgap.common import toml
from simgap.common.errors import RobotError
from simgap.units import UNITS, Quantity, find_unit

TABLE = {
    "name": 'a "quoted" line\nand \u0007 another',
    "flag": True,
    "vector": [1.0 / 3.0, -0.0, 1e-300, 2],
    "matrix": [[1.0, 2.0], [3.0, 4.0]],
    "none": [],
    "group": {"a key": {"value": 1e22}, "list": [{"x": 1}, {"x": 2, "y": {"z": "w"}}]},
}


def test_every_bit_of_a_table_comes_back_below_its_comments():
    text = toml.toml_text(TABLE, ["about", ""])
    assert text.startswith("# about\n#\n\n")
    assert repr(tomllib.loads(text)) == repr(toml.parse_toml(text, "t.toml"))
    assert toml.parse_toml(text, "t.toml") == TABLE
    assert str(toml.parse_toml(text, "t.toml")["vector"][1]) == "-0.0"
    assert "matrix = [\n    [1.0, 2.0],\n" in text


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"[joints", "is not TOML: Expected"),
        (b"x = " + b"9" * 5000, "is not TOML: a whole number has more than"),
        (b"x = 0x" + b"f" * 5000, "is not TOML: a whole number has more than"),
        (b"x = " + b"[" * 100_000, "is not TOML: lists or tables are nested too deeply"),
        (b"\xff\xfe", "is not text in UTF-8"),
        (b" " * 1_000_001, "has 1000001 bytes, more than 1000000"),
    ],
    ids=["torn", "a long number", "a long hexadecimal number", "a deep list", "binary", "large"],
)
def test_a_file_that_is_no_toml_is_refused(tmp_path, content, expected):
    path = tmp_path / "bad.toml"
    path.write_bytes(content)
    with pytest.raises(RobotError, match=rf"bad\.toml: {expected}"):
        toml.read_toml(path)


def test_a_file_that_is_not_there_or_would_be_waited_for_is_refused(tmp_path):
    with pytest.raises(RobotError, match=r"none\.toml: cannot be read \(No such file"):
        toml.read_toml(tmp_path / "none.toml")
    os.mkfifo(tmp_path / "pipe.toml")
    with pytest.raises(RobotError, match=r"pipe\.toml: is not a regular file"):
        toml.read_toml(tmp_path / "pipe.toml")
    with pytest.raises(RobotError, match="is no name of a file; give the path of a text file"):
        toml.read_toml(tmp_path / "zero\0byte.toml")


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path):
    (tmp_path / "mark.toml").write_bytes(b"\xef\xbb\xbfx = 1\n")
    assert toml.read_toml(tmp_path / "mark.toml") == {"x": 1}


@dataclass(frozen=True)
class Wheel:
    radius_m: float


class Rover(toml.Record):
    name: str
    wheel: tuple[Wheel, ...] = ()
    limits: dict[str, tuple[float, float]] | None = None


def faults(**content):
    with pytest.raises(ValidationError) as caught:
        Rover.model_validate(content, strict=False)
    return toml.describe_faults(Rover, caught.value)


def test_faults_name_the_path_of_the_key_and_what_would_be_right():
    assert faults(nam="R") == ["nam: is not known; did you mean name?", "name: is missing; add it"]
    wheels = [{"radius_m": 0.2}, {"radius_m": []}, {"radus_m": 0.2}]
    assert faults(name="R", wheel=wheels) == [
        "wheel[2].radius_m: should be a valid number",
        "wheel[3].radus_m: is not known; did you mean radius_m?",
        "wheel[3].radius_m: is missing; add it",
    ]
    assert faults(name="R", limits={"roll": [1.0]}) == ["limits.roll[2]: is missing; add it"]
    with pytest.raises(RobotError, match=r"rover\.toml: name: should be a valid string, not 3"):
        toml.parse_record(Rover, {"name": 3}, Path("rover.toml"))


@pytest.mark.parametrize(
    ("name", "quantity", "logged", "expected"),
    [
        ("deg", Quantity.ANGLE, 180.0, math.pi),
        ("turn", Quantity.ANGLE, 0.5, math.pi),
        ("mrad", Quantity.ANGLE, 1.0, 1e-3),
        ("rpm", Quantity.SPEED, 60.0, 2 * math.pi),
        ("deg/s", Quantity.SPEED, 180.0, math.pi),
        ("mN m", Quantity.TORQUE, 5.0, 5e-3),
        ("mA", Quantity.CURRENT, 5.0, 5e-3),
        ("K", Quantity.TEMPERATURE, 273.15, 0.0),
        ("us", Quantity.TIME, 1.0, 1e-6),
        ("g0", Quantity.ACCELERATION, 1.0, 9.80665),
        ("%", Quantity.RATIO, 50.0, 0.5),
    ],
)
def test_a_value_is_converted_to_si_units(name, quantity, logged, expected):
    unit = find_unit(name, quantity)
    assert unit.factor * logged + unit.offset == pytest.approx(expected)


def test_every_quantity_has_its_si_unit():
    plain = {one.quantity for one in UNITS.values() if (one.factor, one.offset) == (1.0, 0.0)}
    assert plain == set(Quantity)


def test_a_unit_of_another_quantity_is_refused_with_the_nearest():
    with pytest.raises(ValueError, match="'N m' is no unit of angle; write one of rad, mrad, urad, deg"):
        find_unit("N m", Quantity.ANGLE)
    with pytest.raises(ValueError, match="did you mean 'deg'"):
        find_unit("degs", Quantity.ANGLE)
