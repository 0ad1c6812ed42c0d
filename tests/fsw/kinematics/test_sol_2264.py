"""A pose of the rover on Mars: flight statics against its own estimate, and docs/results.md against both."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.kinematics.arm import Arm, heat_arm
from fsw.kinematics.chain import Frames, forward, tool_pose
from fsw.kinematics.statics import settle, settle_output
from fsw.kinematics.transforms import Pose
from tests.fsw.rig import config_of

PAGE = Path(__file__).resolve().parents[3] / "docs" / "results.md"

# the label of an image of sol 2264: angles, gravity's direction, and the drill where the rover believes it
ENCODER_RAD = np.array([0.799985, -1.570999, -1.500003, 1.678171, 2.761113])
RESOLVER_RAD = np.array([0.797107, -1.576209, -1.506384, 1.673409, 2.760045])
GRAVITY_R_m_s2 = 3.711 * np.array([-0.056348, 0.023005, 0.998146])
FLIGHT_P_R_M = np.array([0.238353, -0.923706, -0.165335])
FLIGHT_Q_TR = np.array([0.1586527, 0.5402789, 0.3604649, 0.7436351])
"""Quaternion (w, x, y, z) from rover to tool; its conjugate is the tool in the rover frame."""

CONFIG = config_of()
ARM, HALF_BACKLASH_RAD = CONFIG.arm, CONFIG.half_backlash_rad
LOADED_SIDE = np.sign(settle(ARM, ENCODER_RAD, np.zeros(5), GRAVITY_R_m_s2).torque_Nm)


def from_quaternion(q) -> np.ndarray:
    """Build the rotation of a unit quaternion (w, x, y, z)."""
    w, (x, y, z) = q[0], q[1:]
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * K + 2 * K @ K


FLIGHT = Pose(from_quaternion(FLIGHT_Q_TR).T, FLIGHT_P_R_M)


def drill(frames: Frames) -> Pose:
    return tool_pose(ARM, frames, "drill")


def deflected_drill(backlash_rad, arm: Arm = ARM) -> Pose:
    """Compute the drill pose for the encoder angles, with wind-up beyond these positions in the backlash."""
    return tool_pose(arm, settle(arm, ENCODER_RAD, backlash_rad, GRAVITY_R_m_s2).frames, "drill")


def across(*joints: Joint) -> Pose:
    """Compute the drill pose with the outputs on the loaded side, but some joints on the other."""
    sides = np.array(LOADED_SIDE)
    sides[list(joints)] *= -1
    return deflected_drill(sides * HALF_BACKLASH_RAD)


def stiffer(factor: float) -> Arm:
    """Scale the stiffness of all links and gears."""
    gears = ARM.gear_stiffness_Nm_rad * factor
    return replace(ARM, compliance=ARM.compliance / factor, gear_stiffness_Nm_rad=gears)


LINES = {
    "rigid": drill(forward(ARM, ENCODER_RAD)),
    "links": drill(settle_output(ARM, ENCODER_RAD, GRAVITY_R_m_s2).frames),
    "wound up": deflected_drill(np.zeros(5)),
    "deflected": across(),
    "J1 across": across(Joint.AZIMUTH),
    "J5 across": across(Joint.TURRET),
    "stiffer": deflected_drill(LOADED_SIDE * HALF_BACKLASH_RAD, stiffer(1.2)),
    "softer": deflected_drill(LOADED_SIDE * HALF_BACKLASH_RAD, stiffer(1 / 1.2)),
    "colder": deflected_drill(LOADED_SIDE * HALF_BACKLASH_RAD, heat_arm(ARM, -60.0)),
}


def apart(X_RT: Pose) -> tuple[np.ndarray, float]:
    """Compute position [m] and angle [rad] from the rover's own estimate."""
    chord = np.linalg.norm(X_RT.R - FLIGHT.R) / np.sqrt(8)
    return X_RT.p - FLIGHT.p, 2 * float(np.arcsin(chord))


PART = PAGE.read_text(encoding="utf-8").split("## Sol 2264: the arm on Mars\n")[1].split("\n## ")[0]
"""Part of the page about this pose."""


def test_the_deflected_drill_is_within_5_mm_and_5_mrad_of_the_rover_s_own_estimate_and_the_rigid_one_is_not():
    """Encoders measure the motors; each gear is wound up on the flank to which its load presses it."""
    (miss, angle), (rigid, turned) = (apart(LINES[name]) for name in ("deflected", "rigid"))
    assert max(np.linalg.norm(miss), angle) < 5e-3
    assert min(np.linalg.norm(rigid), turned) > 20e-3


def test_the_load_decides_the_side_of_three_backlashes_and_leaves_two_to_friction():
    at_rest = settle(ARM, ENCODER_RAD, LOADED_SIDE * HALF_BACKLASH_RAD, GRAVITY_R_m_s2)
    assert at_rest.converged
    np.testing.assert_array_equal(np.sign(at_rest.torque_Nm), LOADED_SIDE)
    left_open = np.abs(at_rest.torque_Nm) < CONFIG.output_friction_Nm
    assert list(np.flatnonzero(left_open)) == [Joint.AZIMUTH, Joint.TURRET]


def test_the_page_says_what_is_computed():
    rows = [[cell.strip(" *") for cell in line.split("|")[1:-1]] for line in PART.splitlines() if "|" in line]
    table = {row[0]: [float(cell) for cell in row[1:]] for row in rows[2:]}
    assert list(table) == list(LINES)[: len(table)]
    computed = {name: apart(X_RT) for name, X_RT in LINES.items()}
    for name, cells in table.items():
        miss, angle = computed[name]
        np.testing.assert_allclose(cells, [1e3 * np.linalg.norm(miss), 1e3 * angle], rtol=0, atol=0.051)
    others_mm = [1e3 * np.linalg.norm(miss) for name, (miss, _) in computed.items() if name not in table]
    assert f"give {min(others_mm):.1f} to {max(others_mm):.1f} mm" in " ".join(PART.split())


def test_the_page_says_where_the_resolvers_are():
    torque_Nm = settle(ARM, ENCODER_RAD, LOADED_SIDE * HALF_BACKLASH_RAD, GRAVITY_R_m_s2).torque_Nm[:4]
    behind, wind_up = RESOLVER_RAD[:4] - ENCODER_RAD[:4], torque_Nm / ARM.gear_stiffness_Nm_rad[:4]
    np.testing.assert_array_equal(np.sign(behind), np.sign(wind_up))
    ranges = [
        f"{1e3 * np.abs(one).min():.1f} to {1e3 * np.abs(one).max():.1f} mrad" for one in (behind, wind_up)
    ]
    assert f"by {ranges[0]}, which is more than the wind-up of {ranges[1]}" in " ".join(PART.split())
