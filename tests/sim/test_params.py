"""Flight parameters load strictly: every error at once, each with its place."""

import json
import re
from dataclasses import asdict, replace
from functools import reduce
from operator import getitem
from pathlib import Path
from textwrap import dedent
from typing import Any

import numpy as np
import pytest

from fsw.dictionary.commands import SetParam
from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import CommandCompleted, CommandRefused
from fsw.dictionary.params import digest
from sim.arms import nominal_params, params_over_nominal
from sim.params import BadParams, params_from_table, params_table
from tests.fsw.rig import Rig, config_of

JOINT_NAMES = [joint.name.lower() for joint in Joint]


def write_file(folder: Path, text: str) -> Path:
    path = folder / "over.toml"
    path.write_text(text)
    return path


def test_a_file_replaces_what_it_names_and_nothing_else(tmp_path):
    path = write_file(tmp_path, 'arm_name = "mine"\n[joints.elbow]\nbacklash_rad = 0.005\n')
    loaded, nominal = params_over_nominal(path), nominal_params()
    assert loaded.joints.elbow.backlash_rad == 0.005
    elbow = replace(nominal.joints.elbow, backlash_rad=0.005)
    assert loaded == replace(nominal, arm_name="mine", joints=replace(nominal.joints, elbow=elbow))


BAD = {
    "dates and times": (
        """
        joints.elbow.backlash_rad = 2012-08-06
        poses.ready_rad = [0.0, 0.0, 05:17:00, 0.0, 0.0]
        """,
        """
        joints.elbow.backlash_rad: 2012-08-06 is a date
        poses.ready_rad.2: 05:17:00 is a date or a time
        """,
    ),
    "a list for the tools": ("tools = []", "tools: "),
    "of another type": (
        """
        joints.elbow.backlash_rad = "wide"
        joints.wrist.lash = 1
        poses.ready_rad = [0.0, 0.0]
        links.arm2.transform = 4
        links.arm7.transform.a_m = 0.3
        tools.drill = 3
        tools.scoop.transform.a_m = 0.3
        tools.apxs.expansion_1_K = [0.0, 0.0, 0.0]
        links.arm3.compliance = [[0, 0, 0, 0, 0]]
        """,
        """
        joints.elbow.backlash_rad:
        joints.wrist.lash: is not known
        poses.ready_rad
        links.arm2.transform:
        links.arm7: is not known
        tools.drill:
        tools.scoop.geometry: is missing
        tools.apxs.expansion_1_K[4]: is missing
        links.arm3.compliance[1][6]: is missing
        """,
    ),
    "out of range": (
        """
        joints.elbow.backlash_rad = 0.5
        joints.wrist.soft_min_rad = 1.0
        joints.wrist.soft_max_rad = -1.0
        motion.guarded_speed_m_s = -0.005
        motion.tool_speed_m_s = inf
        motion.settle_time_s = nan
        monitors.gravity_min_m_s2 = 9.0
        monitors.gravity_max_m_s2 = 2.0
        hardstop.lead_rad = 0.1
        links.arm3.elastic_centre_m = [0.4, -5.1, 0.0]
        links.arm3.far.com_m = [1e300, 0, 0]
        links.arm3.expansion_1_K = [0.0, 0.0, 0.0, 1e300, 0.0, -0.01]
        collision.arm.link5.capsules = [{ from_m = [0, 0, 0.0], to_m = [0, 0, 0.1], radius_m = 0.0 }]
        """,
        """
        joints.elbow.backlash_rad: 0.5 is outside 0.0 .. 0.02
        joints.wrist.soft_min_rad: 1.0 is not below soft_max_rad -1.0
        motion.tool_speed_m_s: must be finite
        motion.settle_time_s: must be finite
        motion.guarded_speed_m_s: -0.005 is outside 0.0001 .. 0.02
        monitors.gravity_min_m_s2: 9.0 is not below gravity_max_m_s2 2.0
        hardstop.lead_rad: 0.1 is outside
        links.arm3.elastic_centre_m.1: -5.1 is outside -5.0 .. 5.0
        links.arm3.far.com_m.0: 1e+300
        links.arm3.expansion_1_K.3: 1e+300 is outside -0.0001 .. 0.0001
        links.arm3.expansion_1_K.5: -0.01 is outside
        collision.arm.link5.capsules.0.radius_m: 0.0 is outside 0.001 .. 1.0
        """,
    ),
    "of no arm": (
        """
        poses.ready_rad = [0.0, -1.0, 2.9, 2.3, 1.6]
        poses.stowed_rad = [1.6, -0.3, -2.8, 3.1, 0.6]
        poses.unstow_via_rad = [[0.0, -1.0, 2.0, 2.0, 1.0], [0.0, -1.0, 2.0, 2.0, 6.0]]
        hardstop.start_rad = [0.0, 0.0, 3.0, 0.0, 0.0]
        joints.wrist.hardstop_rad = -2.8
        links.arm3.transform.a_m = -0.8
        links.arm4.transform.a_m = 0.0
        tools.drill.transform.beta_rad = 1.5707963267948966
        tools.apxs.transform.beta_rad = -1.2
        collision.arm.link3.capsules = []
        collision.rover.mast_head.boxes = []
        collision.rover.chassis.boxes = [{ centre_m = [0.0, 0.0, 0.3], half_m = [0.8, -0.6, 0.3] }]
        """,
        """
        poses.stowed_rad: joint azimuth: 1.6 is outside its soft limits -3.14508 .. 1.59174
        poses.ready_rad: joint elbow: 2.9
        poses.unstow_via_rad.1: joint turret: 6.0
        hardstop.start_rad: joint elbow
        joints.wrist.hardstop_rad: -2.8 is not between
        links.arm3.transform.a_m: -0.8 is below 0.2
        links.arm4.transform.a_m: 0.0 is below 0.2
        tools.drill.transform.beta_rad: 1.5707963267948966 brings the boresight within 0.5 of
        tools.apxs.transform.beta_rad: -1.2
        collision.arm.link3: has neither
        collision.rover.mast_head: has neither
        collision.rover.chassis.boxes.0.half_m: (0.8, -0.6, 0.3) must be positive
        """,
    ),
}
"""Files with wrong values, and the begin of the sentence about each."""


@pytest.mark.parametrize(("text", "expected"), BAD.values(), ids=BAD)
def test_bad_parameters_are_refused_at_once_and_each_is_named_with_its_place(tmp_path, text, expected):
    path = write_file(tmp_path, dedent(text))
    with pytest.raises(BadParams) as refused:
        params_over_nominal(path)
    lines = str(refused.value).splitlines()
    assert all(line.startswith(f"{path}: ") for line in lines)
    for sentence in dedent(expected).strip("\n").splitlines():
        assert any(line.startswith(f"{path}: {sentence}") for line in lines), (sentence, lines)


UPPER_RAD = {name: getattr(nominal_params().joints, name).upper_hardstop_rad for name in JOINT_NAMES}
LOWER_RAD = {name: getattr(nominal_params().joints, name).hardstop_rad for name in JOINT_NAMES}
NO_ARM = [
    *((f"joints.{name}.soft_max_rad", at + 1e-3, "is above") for name, at in UPPER_RAD.items()),
    *((f"joints.{name}.soft_max_rad", at - 0.011, "0.012 below upper_") for name, at in UPPER_RAD.items()),
    *((f"joints.{name}.soft_min_rad", at - 1e-3, "is not between 0.012") for name, at in LOWER_RAD.items()),
    ("joints.elbow.upper_hardstop_rad", 2.87, "joints.elbow.soft_max_rad: 2.86583"),
    ("joints.azimuth.soft_min_rad", -3.09, "hardstop.park_rad: joint azimuth: -3.099705 is outside"),
    ("joints.wrist.soft_max_rad", 1.0, "poses.stowed_rad: joint wrist"),
    ("joints.elbow.soft_max_rad", 1.0, "poses.ready_rad: joint elbow"),
    ("joints.turret.soft_min_rad", -0.28, "joints.turret.hardstop_rad: -0.38746 is not between"),
    (
        "hardstop.retreat_rad",
        0.005,
        "hardstop.retreat_rad: 0.005 is not above 0.00536, backlash of the wrist",
    ),
    ("hardstop.lead_rad", 0.002, None),
    ("hardstop.fine_speed_rad_s", 0.009, "hardstop.fine_speed_rad_s: 0.009 is above 0.00872"),
    ("hardstop.coarse_speed_share", 0.09, "hardstop.fine_speed_rad_s: 0.00174"),
    ("motion.settle_timeout_s", 0.2, "motion.settle_timeout_s: 0.2 is not above settle_time_s 0.25"),
    ("motion.settle_error_rad", 2e-6, "motion.settle_error_rad: 2e-06 is below 3.26e-06, an encoder count"),
    ("joints.turret.gear_ratio", 800.0, "motion.settle_error_rad: 3e-05 is below 3.07e-05, an encoder count"),
    ("monitors.guarded_force_N", 2.0, "monitors.guarded_force_N: 2.0 is not above motion.switch_force_N 2"),
    ("motion.switch_force_N", 25.0, "monitors.guarded_force_N: 25.0 is not above motion.switch_force_N 25"),
    ("motion.line_step_m", 0.004, "motion.line_step_m: 0.004 is below 0.005, a 120th of motion.line_max_m"),
    ("preload.step_N", 1.0, "preload.step_N: 1.0 is below 2.92, a 120th of preload.max_force_N"),
    ("preload.max_force_N", 11.0, "preload.max_force_N: 11.0 is below 12, motion.switch_force_N and"),
]
"""A parameter, a value within its own limits, and what is said of it; None where the arm can have it."""


@pytest.mark.parametrize(("name", "value", "said"), NO_ARM)
def test_what_no_arm_can_have_is_refused_alike_as_a_command_and_in_a_file(tmp_path, name, value, said):
    rig = Rig(config_of())
    rig.cycle(SetParam(name, value))
    path = write_file(tmp_path, f"{name} = {value}\n")
    if said is None:
        assert CommandCompleted("SetParam") in rig.evrs
        params_over_nominal(path)
        return
    (refused,) = (evr for evr in rig.evrs if isinstance(evr, CommandRefused))
    assert said in refused.reason
    with pytest.raises(BadParams) as bad:
        params_over_nominal(path)
    assert f"{path}: {refused.reason}" in str(bad.value).splitlines()


@pytest.mark.parametrize("name", JOINT_NAMES)
def test_a_soft_limit_may_lie_as_near_to_its_hardstop_as_a_motor_may_pass_it(name):
    rig = Rig(config_of())
    rig.cycle(SetParam(f"joints.{name}.soft_max_rad", UPPER_RAD[name] - 0.0121))
    rig.cycle(SetParam(f"joints.{name}.soft_min_rad", LOWER_RAD[name] + 0.0121))
    assert rig.evrs.count(CommandCompleted("SetParam")) == 2


@pytest.mark.parametrize("off_rad", [0.019, 0.021, -0.021, np.pi / 2, -np.pi])
def test_each_axis_is_within_twenty_milliradians_of_the_orthogonal_arm(tmp_path, off_rad):
    right_rad = {(f"arm{k}", angle): 0.0 for k in range(2, 7) for angle in ("alpha_rad", "beta_rad")}
    right_rad |= {("arm2", "alpha_rad"): np.pi / 2, ("arm5", "alpha_rad"): -np.pi / 2}
    lines = (
        f"links.{link}.transform.{angle} = {rad + off_rad}\n" for (link, angle), rad in right_rad.items()
    )
    path = write_file(tmp_path, "".join(lines))
    if abs(off_rad) < 0.02:
        params_over_nominal(path)
    else:
        with pytest.raises(BadParams) as refused:
            params_over_nominal(path)
        for (link, angle), rad in right_rad.items():
            where = rf"links\.{link}\.transform\.{angle}: \S+ is not within 0.02 of "
            said = f"{where}the orthogonal arm's {rad:.6g}$"
            assert re.search(said, str(refused.value), re.MULTILINE), said


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
        ({(1, 5): 1e-9, (5, 1): 1e-9 * (1 + 1e-15)}, None),
        ({(k, k): 0.0 for k in range(6)}, None),
    ],
)
def test_only_the_compliance_of_a_spring_or_of_a_rigid_link_is_taken(tmp_path, changes, expected):
    rows = [list(row) for row in nominal_params().links.arm3.compliance]
    for (row, column), value in changes.items():
        rows[row][column] = value
    path = write_file(tmp_path, f"[links.arm3]\ncompliance = {rows}\n")
    if expected is None:
        params_over_nominal(path)
    else:
        with pytest.raises(BadParams, match=r"over\.toml: links\.arm3\.compliance: (" + expected + ")"):
            params_over_nominal(path)


@pytest.mark.parametrize(
    ("tool", "where"), [("drill", "switches.drill_1"), ("portion", "teach.inlet_1.tool")]
)
def test_a_missing_tool_is_named_where_it_is_used(tool, where):
    table = nominal_table()
    del table["tools"][tool]
    known = ", ".join(table["tools"])
    with pytest.raises(
        BadParams, match=rf"nominal\.toml: {where}: tool '{tool}' is not known; there are {known}"
    ):
        params_from_table(table, "nominal.toml")


@pytest.mark.parametrize(
    "missing",
    ["tools", "tools.drill.geometry", "tools.apxs.transform", "links.arm1", "joints.turret", "poses"],
)
def test_what_is_missing_is_named(missing):
    """A file over the nominal one may leave anything out; the nominal one may not."""
    table = nominal_table()
    *groups, name = missing.split(".")
    del reduce(getitem, groups, table)[name]
    with pytest.raises(BadParams, match=rf"nominal\.toml: {re.escape(missing)}: is missing"):
        params_from_table(table, "nominal.toml")


def nominal_table() -> dict[str, Any]:
    """Return the content of the nominal file, with lists in place of tuples, to be changed."""
    table: dict[str, Any] = json.loads(json.dumps(params_table(nominal_params())))
    return table


def test_the_digest_is_of_the_values_and_not_of_their_order_or_notation(tmp_path):
    one, other = (
        params_over_nominal(write_file(tmp_path, text))
        for text in (
            "[joints.elbow]\nbacklash_rad = 0.005\ngear_ratio = 7000.0\n[motion]\nsettle_time_s = 1.0\n",
            "motion = { settle_time_s = 1.00 }\n[joints.elbow]\ngear_ratio = 7000\nbacklash_rad = 5e-3\n",
        )
    )
    assert digest(one) == digest(other)


def test_the_digest_changes_with_the_last_bit_of_any_number():
    params = nominal_params()
    elbow = params.joints.elbow
    nudged = replace(elbow, backlash_rad=float(np.nextafter(elbow.backlash_rad, 1.0)))
    assert digest(replace(params, joints=replace(params.joints, elbow=nudged))) != digest(params)
    assert len(digest(params)) == 64
    assert asdict(nominal_params()) == asdict(params)
