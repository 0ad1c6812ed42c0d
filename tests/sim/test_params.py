"""Flight parameters load strictly: every error at once, each with its place."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from sim.params import BadParams, digest, nominal_params, out_of_limits, params_over_nominal


def written(folder: Path, text: str) -> Path:
    path = folder / "over.toml"
    path.write_text(text)
    return path


def test_nominal_parameters_are_within_their_limits() -> None:
    assert list(out_of_limits(nominal_params())) == []


def test_a_file_replaces_what_it_names_and_nothing_else(tmp_path: Path) -> None:
    path = written(tmp_path, 'arm_name = "mine"\n[joints.elbow]\nbacklash_rad = 0.005\n')
    loaded, nominal = params_over_nominal(path), nominal_params()
    assert loaded.joints.elbow.backlash_rad == 0.005
    elbow = replace(nominal.joints.elbow, backlash_rad=0.005)
    assert loaded == replace(nominal, arm_name="mine", joints=replace(nominal.joints, elbow=elbow))


BAD = {
    "unknown key": ("[joints.elbow]\nbacklash = 0.005\n", ["joints.elbow.backlash: "]),
    "unknown group": ("[jonts.elbow]\nbacklash_rad = 0.005\n", ["jonts: "]),
    "text for a number": ('[joints.elbow]\nbacklash_rad = "wide"\n', ["joints.elbow.backlash_rad: "]),
    "text of a number": ('[joints.elbow]\nbacklash_rad = "0.005"\n', ["joints.elbow.backlash_rad: "]),
    "truth for a number": ("[joints.elbow]\nbacklash_rad = true\n", ["joints.elbow.backlash_rad: "]),
    "fraction for a count": (
        "[joints.elbow]\nencoder_counts_per_turn = 255.5\n",
        ["joints.elbow.encoder_counts_per_turn: "],
    ),
    "number for a group": ("joints = 3\n", ["joints: "]),
    "too few numbers": ("[poses]\nready_rad = [0.0, 0.0]\n", ["poses.ready_rad"]),
    "not a number": ("[joints.elbow]\nbacklash_rad = nan\n", ["joints.elbow.backlash_rad: "]),
    "infinite": ("[motion]\nguarded_speed_m_s = inf\n", ["motion.guarded_speed_m_s: "]),
    "NaN in a list": ("[poses]\nready_rad = [0.0, 0.0, nan, 0.0, 0.0]\n", ["poses.ready_rad"]),
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
    "an unknown name": ("[joints.elbow]\nlash = 1\n", ["joints.elbow.lash: is not a parameter"]),
    "an unknown group": ("[elbows]\nlash = 1\n", ["elbows: is not a parameter"]),
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
        ["links.arm4.transform.a_m: 0.0 is below 0.05"],
    ),
    "an upper arm turned round": (
        "[links.arm3.transform]\na_m = -0.8\n",
        ["links.arm3.transform.a_m: -0.8 is below 0.05"],
    ),
    "a shoulder without a right angle": (
        "[links.arm2.transform]\nalpha_rad = 1.0\n",
        ["links.arm2.transform.alpha_rad: 1.0 is not within 0.5 of a right angle"],
    ),
    "a wrist without a right angle": (
        "[links.arm5.transform]\nalpha_rad = 0.0\n",
        ["links.arm5.transform.alpha_rad: 0.0 "],
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


@pytest.mark.parametrize(("text", "said"), BAD.values(), ids=BAD)
def test_bad_parameters_are_refused_and_each_is_named_with_its_place(
    tmp_path: Path, text: str, said: list[str]
) -> None:
    path = written(tmp_path, text)
    with pytest.raises(BadParams) as refused:
        params_over_nominal(path)
    lines = str(refused.value).splitlines()
    assert all(line.startswith(f"{path}: ") for line in lines)
    for sentence in said:
        assert any(line.startswith(f"{path}: {sentence}") for line in lines), (sentence, lines)


def compliance(changes: dict[tuple[int, int], float]) -> str:
    """The nominal upper arm with other entries in its compliance."""
    rows = [list(row) for row in nominal_params().links.arm3.compliance]
    for (row, column), value in changes.items():
        rows[row][column] = value
    return f"[links.arm3]\ncompliance = {rows}\n"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({(0, 4): 1e-9}, r"is not symmetric: 1e-09 at \[0\]\[4\], 0.0 across"),
        ({(2, 2): -1e-9}, "is not positive semidefinite"),
        ({(1, 5): 1e-5, (5, 1): 1e-5}, "is not positive semidefinite"),
        ({(3, 3): 0.0, (3, 4): 1e-13, (4, 3): 1e-13}, "is not positive semidefinite"),
    ],
    ids=["lopsided", "negative", "coupled too much", "coupled to nothing"],
)
def test_a_compliance_of_no_spring_is_refused(
    tmp_path: Path, changes: dict[tuple[int, int], float], said: str
) -> None:
    with pytest.raises(BadParams, match=r"over\.toml: links\.arm3\.compliance: (" + said + ")"):
        params_over_nominal(written(tmp_path, compliance(changes)))


@pytest.mark.parametrize(
    "changes",
    [{(1, 5): 1e-9, (5, 1): 1e-9 * (1 + 1e-15)}, {(k, k): 0.0 for k in range(6)}],
    ids=["coupled, rounded", "rigid"],
)
def test_the_compliance_of_a_spring_is_taken(tmp_path: Path, changes: dict[tuple[int, int], float]) -> None:
    params_over_nominal(written(tmp_path, compliance(changes)))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"[joints", "is not TOML"),
        (b"arm_name = " + b"9" * 5000, "is not TOML"),
        (b"arm_name = " + b"[" * 100_000, "is not TOML"),
        (b"\xff\xfe", "cannot be read"),
    ],
    ids=["torn", "a number without end", "a list without end", "binary"],
)
def test_a_file_that_is_not_toml_is_refused(tmp_path: Path, content: bytes, said: str) -> None:
    path = tmp_path / "over.toml"
    path.write_bytes(content)
    with pytest.raises(BadParams, match=said):
        params_over_nominal(path)


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadParams, match=r"nothing\.toml: cannot be read"):
        params_over_nominal(tmp_path / "nothing.toml")


def test_the_digest_is_of_the_values_and_not_of_their_order(tmp_path: Path) -> None:
    one = written(
        tmp_path, "[joints.elbow]\nbacklash_rad = 0.005\ngear_ratio = 7000.0\n[motion]\nsettle_time_s = 1.0\n"
    )
    params = params_over_nominal(one)
    other = tmp_path / "other.toml"
    other.write_text(
        "motion = { settle_time_s = 1.00 }\n[joints.elbow]\ngear_ratio = 7e3\nbacklash_rad = 5e-3\n"
    )
    assert digest(params_over_nominal(other)) == digest(params)


def test_a_whole_number_is_the_same_as_one_with_a_point(tmp_path: Path) -> None:
    whole = params_over_nominal(written(tmp_path, "[joints.elbow]\ngear_ratio = 7000\n"))
    point = params_over_nominal(written(tmp_path, "[joints.elbow]\ngear_ratio = 7000.0\n"))
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


def test_a_link_softer_than_any_link_is_named(tmp_path):
    file = tmp_path / "soft.toml"
    rows = [[0.1 if row == column < 3 else 0.0 for column in range(6)] for row in range(6)]
    file.write_text(f"[links.arm3]\ncompliance = {rows}\n")
    with pytest.raises(BadParams, match=r"links\.arm3\.compliance: 0\.1 is softer than any link"):
        params_over_nominal(file)
