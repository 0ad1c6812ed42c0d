"""Flight parameters load strictly: every error at once, each with its place."""

import json
import re
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fsw.config import digest
from fsw.dictionary.validity import check_limits
from sim.params import nominal_params, params_over_nominal
from sim.params_table import BadParams, params_from_table, params_table


def write_file(folder: Path, text: str) -> Path:
    path = folder / "over.toml"
    path.write_text(text)
    return path


def test_nominal_parameters_are_within_their_limits() -> None:
    assert list(check_limits(nominal_params())) == []


def test_a_file_replaces_what_it_names_and_nothing_else(tmp_path: Path) -> None:
    path = write_file(tmp_path, 'arm_name = "mine"\n[joints.elbow]\nbacklash_rad = 0.005\n')
    loaded, nominal = params_over_nominal(path), nominal_params()
    assert loaded.joints.elbow.backlash_rad == 0.005
    elbow = replace(nominal.joints.elbow, backlash_rad=0.005)
    assert loaded == replace(nominal, arm_name="mine", joints=replace(nominal.joints, elbow=elbow))


BAD = {
    "text for a number": ('[joints.elbow]\nbacklash_rad = "wide"\n', ["joints.elbow.backlash_rad: "]),
    "too few numbers": ("[poses]\nready_rad = [0.0, 0.0]\n", ["poses.ready_rad"]),
    "not a number": ("[joints.elbow]\nbacklash_rad = nan\n", ["joints.elbow.backlash_rad: "]),
    "infinite": ("[motion]\nguarded_speed_m_s = inf\n", ["motion.guarded_speed_m_s: "]),
    "too large": (
        "[joints.elbow]\nbacklash_rad = 0.5\n",
        ["joints.elbow.backlash_rad: 0.5 is outside 0.0 .. 0.02"],
    ),
    "negative": (
        "[motion]\nguarded_speed_m_s = -0.005\n",
        ["motion.guarded_speed_m_s: -0.005 is outside 0.0001 .. 0.02"],
    ),
    "limits upside down": (
        "[joints.wrist]\nsoft_min_rad = 1.0\nsoft_max_rad = -1.0\n",
        ["joints.wrist.soft_min_rad: 1.0 is not below soft_max_rad -1.0"],
    ),
    "a date": (
        "[joints.elbow]\nbacklash_rad = 2012-08-06\n",
        ["joints.elbow.backlash_rad: 2012-08-06 is a date"],
    ),
    "a time in a list": (
        "[poses]\nready_rad = [0.0, 0.0, 05:17:00, 0.0, 0.0]\n",
        ["poses.ready_rad.2: 05:17:00 is a date or a time"],
    ),
    "an unknown name": ("[joints.elbow]\nlash = 1\n", ["joints.elbow.lash: is not known"]),
    "a vector beyond the rover": (
        "[links.arm3]\nelastic_centre_m = [0.4, -5.1, 0.0]\nfar = { com_m = [1e300, 0, 0] }\n",
        ["links.arm3.elastic_centre_m.1: -5.1 is outside -5.0 .. 5.0", "links.arm3.far.com_m.0: 1e+300 "],
    ),
    "poses beyond the soft limits": (
        "[poses]\nready_rad = [0.0, -1.0, 2.9, 2.3, 1.6]\nstowed_rad = [1.6, -0.3, -2.8, 3.1, 0.6]\n"
        "unstow_via_rad = [[0.0, -1.0, 2.0, 2.0, 1.0], [0.0, -1.0, 2.0, 2.0, 6.0]]\n",
        [
            "poses.stowed_rad: joint azimuth: 1.6 is outside its soft limits -3.14508 .. 1.59174",
            "poses.ready_rad: joint elbow: 2.9 ",
            "poses.unstow_via_rad.1: joint turret: 6.0 ",
        ],
    ),
    "a forearm without length": (
        "[links.arm4.transform]\na_m = 0.0\n",
        ["links.arm4.transform.a_m: 0.0 is below 0.2"],
    ),
    "an upper arm turned round": (
        "[links.arm3.transform]\na_m = -0.8\n",
        ["links.arm3.transform.a_m: -0.8 is below 0.2"],
    ),
    "a shoulder without a right angle": (
        "[links.arm2.transform]\nalpha_rad = 1.0\n",
        ["links.arm2.transform.alpha_rad: 1.0 is not within 0.02 of the orthogonal arm's 1.5708"],
    ),
    "a wrist without a right angle": (
        "[links.arm5.transform]\nalpha_rad = 0.0\n",
        ["links.arm5.transform.alpha_rad: 0.0 is not within 0.02 of the orthogonal arm's -1.5708"],
    ),
    "an azimuth axis along the elevation axis": (
        "[links.arm2.transform]\nalpha_rad = 0.0\n",
        ["links.arm2.transform.alpha_rad: 0.0 "],
    ),
    "an elevation axis turned over": (
        "[links.arm2.transform]\nalpha_rad = -1.5707963267948966\n",
        ["links.arm2.transform.alpha_rad: -1.5707963267948966 "],
    ),
    "an upper arm along its own joint axis": (
        "[links.arm3.transform]\nbeta_rad = 1.5707963267948966\n",
        ["links.arm3.transform.beta_rad: 1.5707963267948966 is not within 0.02 of the orthogonal arm's 0"],
    ),
    "a forearm along its own joint axis": (
        "[links.arm4.transform]\nbeta_rad = -1.5707963267948966\n",
        ["links.arm4.transform.beta_rad: -1.5707963267948966 "],
    ),
    "an elbow that does not pitch": (
        "[links.arm3.transform]\nalpha_rad = 1.5707963267948966\n",
        ["links.arm3.transform.alpha_rad: 1.5707963267948966 "],
    ),
    "a turret interface on its side": (
        "[links.arm6.transform]\nalpha_rad = 1.0\n",
        ["links.arm6.transform.alpha_rad: 1.0 "],
    ),
    "a boresight along the turret axis": (
        "[tools.drill.transform]\nbeta_rad = 1.5707963267948966\n[tools.apxs.transform]\nbeta_rad = -1.2\n",
        [
            "tools.drill.transform.beta_rad: 1.5707963267948966 brings the boresight within 0.5 of",
            "tools.apxs.transform.beta_rad: -1.2 ",
        ],
    ),
    "a part without a shape": (
        "[collision.arm.link3]\ncapsules = []\n[collision.rover.mast_head]\nboxes = []\n",
        ["collision.arm.link3: has neither ", "collision.rover.mast_head: has neither "],
    ),
    "a box inside out": (
        "[[collision.rover.chassis.boxes]]\ncentre_m = [0.0, 0.0, 0.3]\nhalf_m = [0.8, -0.6, 0.3]\n",
        ["collision.rover.chassis.boxes.0.half_m: (0.8, -0.6, 0.3) must be positive"],
    ),
    "a capsule without a radius": (
        "[[collision.arm.link5.capsules]]\nfrom_m = [0, 0, 0.0]\nto_m = [0, 0, 0.1]\nradius_m = 0.0\n",
        ["collision.arm.link5.capsules.0.radius_m: 0.0 is outside 0.001 .. 1.0"],
    ),
    "a tool that there is not": (
        "[tools.scoop.transform]\na_m = 0.3\n",
        ["tools.scoop.geometry: is missing"],
    ),
    "a link that there is not": ("[links.arm7.transform]\na_m = 0.3\n", ["links.arm7: is not known"]),
    "a number for a tool": ("[tools]\ndrill = 3\n", ["tools.drill: "]),
    "a list for the tools": ("tools = []\n", ["tools: "]),
    "a growth beyond any metal": (
        "[links.arm3]\nexpansion_1_K = [0.0, 0.0, 0.0, 1e300, 0.0, -0.01]\n",
        [
            "links.arm3.expansion_1_K.3: 1e+300 is outside -0.0001 .. 0.0001",
            "links.arm3.expansion_1_K.5: -0.01 is outside",
        ],
    ),
    "a growth along too few axes": (
        "[tools.apxs]\nexpansion_1_K = [0.0, 0.0, 0.0]\n",
        ["tools.apxs.expansion_1_K[4]: is missing"],
    ),
    "a compliance with a short row": (
        f"[links.arm3]\ncompliance = {[[0.0] * 6] * 5 + [[0.0] * 5]}\n",
        ["links.arm3.compliance[6][6]: is missing"],
    ),
    "three of them at once": (
        '[joints.elbow]\nbacklash = 1.0\n[motion]\nsettle_time_s = "long"\n[links.arm2]\ntransform = 4\n',
        ["joints.elbow.backlash: ", "motion.settle_time_s: ", "links.arm2.transform: "],
    ),
    "three out of range at once": (
        "[joints.elbow]\nbacklash_rad = 1.0\n[motion]\nsettle_time_s = 11.0\n"
        "[links.arm2.transform]\na_m = 9.0\n",
        ["joints.elbow.backlash_rad: 1.0 ", "motion.settle_time_s: 11.0 ", "links.arm2.transform.a_m: 9.0 "],
    ),
}


@pytest.mark.parametrize(("text", "expected"), BAD.values(), ids=BAD)
def test_bad_parameters_are_refused_and_each_is_named_with_its_place(
    tmp_path: Path, text: str, expected: list[str]
) -> None:
    path = write_file(tmp_path, text)
    with pytest.raises(BadParams) as refused:
        params_over_nominal(path)
    lines = str(refused.value).splitlines()
    assert all(line.startswith(f"{path}: ") for line in lines)
    for sentence in expected:
        assert any(line.startswith(f"{path}: {sentence}") for line in lines), (sentence, lines)


def compliance(changes: dict[tuple[int, int], float]) -> str:
    """Return the nominal upper arm with other entries in its compliance."""
    rows = [list(row) for row in nominal_params().links.arm3.compliance]
    for (row, column), value in changes.items():
        rows[row][column] = value
    return f"[links.arm3]\ncompliance = {rows}\n"


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({(0, 4): 1e-9}, r"is not symmetric: 1e-09 at \[0\]\[4\], 0.0 across"),
        ({(2, 2): -1e-9}, "is not positive semidefinite"),
        ({(1, 5): 1e-5, (5, 1): 1e-5}, "is not positive semidefinite"),
        ({(3, 3): 0.0, (3, 4): 1e-13, (4, 3): 1e-13}, "is not positive semidefinite"),
        ({(0, 0): float("nan")}, "must be finite"),
        ({(0, 1): 1e308, (1, 0): -1e308}, r"1e\+308 is outside -0\.0001 \.\. 0\.0001"),
        ({(2, 2): -0.1}, r"-0\.1 is outside -0\.0001 \.\. 0\.0001"),
        # each pair of axes alone would do; all three give way against a moment along (1, 1, 1)
        ({(a, b): 8e-6 if a == b else -8e-6 for a in range(3) for b in range(3)}, "is not positive semidef"),
    ],
    ids=[
        "lopsided",
        "negative",
        "coupled too much",
        "coupled to nothing",
        "not a number",
        "without measure",
        "pushing",
        "three coupled too much",
    ],
)
def test_a_compliance_of_no_spring_is_refused(
    tmp_path: Path, changes: dict[tuple[int, int], float], expected: str
) -> None:
    with pytest.raises(BadParams, match=r"over\.toml: links\.arm3\.compliance: (" + expected + ")"):
        params_over_nominal(write_file(tmp_path, compliance(changes)))


@pytest.mark.parametrize("link", ["arm1", "arm2", "arm3", "arm4", "arm5", "arm6"])
def test_the_compliance_of_every_link_is_looked_at(tmp_path: Path, link: str) -> None:
    rows = [[-1e-9 if row == column == 3 else 0.0 for column in range(6)] for row in range(6)]
    with pytest.raises(BadParams, match=rf"links\.{link}\.compliance: is not positive semidefinite"):
        params_over_nominal(write_file(tmp_path, f"[links.{link}]\ncompliance = {rows}\n"))


@pytest.mark.parametrize(
    ("missing", "sentence"),
    [
        ("tools.drill", "switches.drill_1: tool 'drill' is not known; there are drt, mahli, apxs, portion"),
        (
            "tools.portion",
            "teach.inlet_1.tool: tool 'portion' is not known; there are drill, drt, mahli, apxs",
        ),
    ],
)
def test_a_missing_tool_is_named_where_it_is_used(missing: str, sentence: str) -> None:
    table = nominal_table()
    del table["tools"][missing.removeprefix("tools.")]
    with pytest.raises(BadParams, match=rf"nominal\.toml: {re.escape(sentence)}"):
        params_from_table(table, "nominal.toml")


@pytest.mark.parametrize(
    "missing",
    [
        "tools",
        "switches",
        "tools.drill.geometry",
        "tools.apxs.transform",
        "links.arm1",
        "links.arm6",
        "joints.turret",
        "poses",
    ],
)
def test_what_is_missing_is_named(missing: str) -> None:
    """A file over the nominal one may leave anything out; the nominal one may not."""
    table = nominal_table()
    *groups, name = missing.split(".")
    group = table
    for key in groups:
        group = group[key]
    del group[name]
    with pytest.raises(BadParams, match=rf"nominal\.toml: {re.escape(missing)}: is missing"):
        params_from_table(table, "nominal.toml")


@pytest.mark.slow
def test_any_number_that_is_not_one_is_named() -> None:
    places = list(numbers_of(nominal_table()))
    assert len(places) > 300
    for place in places:
        table = nominal_table()
        group = table
        for key in place[:-1]:
            group = group[key]
        group[place[-1]] = float("nan")
        field = ".".join(_field_of(table, place))
        with pytest.raises(BadParams, match=rf"nominal\.toml: {re.escape(field)}\b"):
            params_from_table(table, "nominal.toml")


def nominal_table() -> dict[str, Any]:
    """Return the content of the nominal file, with lists in place of tuples, to be changed."""
    table: dict[str, Any] = json.loads(json.dumps(params_table(nominal_params())))
    return table


def _field_of(table: Any, place: tuple[str | int, ...]) -> Iterator[str]:
    """Yield the names on the way to a number; a record of a list goes by its name or number."""
    for key in place:
        table = table[key]
        if isinstance(key, str):
            yield key
        elif isinstance(table, dict):
            yield table.get("name", str(key))


def numbers_of(table: Any, place: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Return the places of the numbers of a table."""
    if isinstance(table, dict | list):
        for key, value in table.items() if isinstance(table, dict) else enumerate(table):
            yield from numbers_of(value, (*place, key))
    elif isinstance(table, int | float):
        yield place


@pytest.mark.parametrize(
    "changes",
    [{(1, 5): 1e-9, (5, 1): 1e-9 * (1 + 1e-15)}, {(k, k): 0.0 for k in range(6)}],
    ids=["coupled, rounded", "rigid"],
)
def test_the_compliance_of_a_spring_is_taken(tmp_path: Path, changes: dict[tuple[int, int], float]) -> None:
    params_over_nominal(write_file(tmp_path, compliance(changes)))


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadParams, match=r"nothing\.toml: cannot be read"):
        params_over_nominal(tmp_path / "nothing.toml")


def test_the_digest_is_of_the_values_and_not_of_their_order(tmp_path: Path) -> None:
    one = write_file(
        tmp_path, "[joints.elbow]\nbacklash_rad = 0.005\ngear_ratio = 7000.0\n[motion]\nsettle_time_s = 1.0\n"
    )
    params = params_over_nominal(one)
    other = tmp_path / "other.toml"
    other.write_text(
        "motion = { settle_time_s = 1.00 }\n[joints.elbow]\ngear_ratio = 7e3\nbacklash_rad = 5e-3\n"
    )
    assert digest(params_over_nominal(other)) == digest(params)


def test_a_whole_number_is_the_same_as_one_with_a_point(tmp_path: Path) -> None:
    whole = params_over_nominal(write_file(tmp_path, "[joints.elbow]\ngear_ratio = 7000\n"))
    point = params_over_nominal(write_file(tmp_path, "[joints.elbow]\ngear_ratio = 7000.0\n"))
    assert digest(whole) == digest(point)


def test_the_digest_changes_with_the_last_bit_of_any_number() -> None:
    params = nominal_params()
    elbow = params.joints.elbow
    nudged = replace(elbow, backlash_rad=float(np.nextafter(elbow.backlash_rad, 1.0)))
    assert digest(replace(params, joints=replace(params.joints, elbow=nudged))) != digest(params)
    assert len(digest(params)) == 64
    assert asdict(nominal_params()) == asdict(params)


def test_bounds_that_are_upside_down_are_named(tmp_path):
    file = tmp_path / "bounds.toml"
    file.write_text("[monitors]\ngravity_min_m_s2 = 9.0\ngravity_max_m_s2 = 2.0\n")
    with pytest.raises(
        BadParams, match=r"monitors\.gravity_min_m_s2: 9\.0 is not below gravity_max_m_s2 2\.0"
    ):
        params_over_nominal(file)
