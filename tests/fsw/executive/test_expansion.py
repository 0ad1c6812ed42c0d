"""Compound commands: their steps, and the check of all steps before the first one begins."""

import numpy as np
import pytest

from fsw.dictionary.commands import (
    ROVER,
    Calibrate,
    Dock,
    GuardedMove,
    MoveJoints,
    MoveTeachPoint,
    MoveTool,
    PlaceTool,
    Process,
    Retract,
    ToolChange,
)
from fsw.dictionary.enums import Frame, Mode
from fsw.dictionary.evrs import CommandCompleted, CommandRefused, ContactMade, SpotSet
from fsw.executive.expansion import expand_command
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.statics import settle_output
from fsw.state import Hold
from tests.fsw.executive import lab
from tests.fsw.rig import floats
from tests.tools import SWITCHES

MAHLI_TOUCHED = {"switch_closed": np.isin(SWITCHES, ["mahli_1a"])}


def test_a_placement_is_a_standoff_and_a_guarded_line_through_the_place():
    p, approach = np.array(lab.HERE.p_RoTo_R_m), np.array(lab.HERE.approach_R)
    command = PlaceTool("apxs", lab.HERE.p_RoTo_R_m, floats(3 * approach), 0.04, 0.02)
    rig = lab.deployed()
    to_standoff, touch = steps_of(rig, command)
    assert isinstance(to_standoff, MoveTool)
    assert isinstance(touch, GuardedMove)
    np.testing.assert_allclose(to_standoff.p_FoTo_F_m, p - 0.04 * approach, atol=1e-12)
    np.testing.assert_allclose(touch.end_p_RoTo_R_m, p + 0.02 * approach, atol=1e-12)
    assert to_standoff.line_m == pytest.approx(0.06)
    rig.cycle(lab.COMMANDS[PlaceTool](rig))
    while rig.state.mode is not Mode.GUARDED:
        rig.cycle()
    evrs = rig.run(**lab.TOUCHED)
    done = [evr.command for evr in rig.evrs if isinstance(evr, CommandCompleted)]
    assert done == ["MoveTool", "GuardedMove", "PlaceTool"]
    assert any(isinstance(evr, ContactMade) for evr in evrs)
    assert rig.state.mode is Mode.GUARDED


def test_a_step_that_cannot_be_is_found_before_the_first_begins():
    rig = lab.deployed()
    far = rig.here("apxs", 0.0)
    command = PlaceTool("apxs", far.p_FoTo_F_m, far.approach_F, standoff_m=0.9, overtravel_m=0.9)
    reason = lab.refusal(rig, command)
    assert reason.startswith("apxs: the target: ")
    assert "clear" not in reason


def steps_of(rig, command):
    return expand_command(lab.CONFIG, rig.state.joints, rig.state.tool, command)


def test_a_tool_change_counts_from_where_the_touching_tool_is_believed_to_be():
    rig = lab.guarded_in_contact()
    X = rig.tool_pose("apxs")
    back, to_standoff, touch = steps_of(rig, ToolChange("mahli"))
    assert back == Retract("apxs", 0.10, "on", "absolute")
    np.testing.assert_allclose(to_standoff.p_FoTo_F_m, X.p - 0.10 * X.R[:, 0], atol=2e-5)
    np.testing.assert_allclose(touch.approach_R, X.R[:, 0], atol=1e-5)
    assert (to_standoff.tool, touch.tool) == ("mahli", "mahli")
    # without compensation it counts from the rigid arm
    back, to_standoff, touch = steps_of(rig, ToolChange("mahli", deflection="off"))
    assert {back.deflection, to_standoff.deflection, touch.deflection} == {"off"}
    spot = np.array(to_standoff.p_FoTo_F_m) + 0.10 * np.array(to_standoff.approach_F)
    assert 2e-3 < np.linalg.norm(spot - X.p) < 0.1


def test_a_tool_that_is_not_to_touch_stops_in_front_of_the_spot():
    *_, to_standoff, hover = steps_of(lab.guarded_in_contact(), ToolChange("portion", hover_m=0.03))
    assert hover.straight
    apart = np.array(hover.p_FoTo_F_m) - np.array(to_standoff.p_FoTo_F_m)
    np.testing.assert_allclose(apart, 0.07 * np.array(hover.approach_F), atol=1e-12)


def test_a_tool_change_ends_with_the_other_tool_in_contact():
    rig = lab.guarded_in_contact()
    rig.begin(ToolChange("mahli", standoff_m=0.05), **lab.TOUCHED)
    assert any(isinstance(evr, SpotSet) for evr in rig.evrs)
    while rig.state.mode is not Mode.GUARDED or rig.state.tool != "mahli":
        rig.cycle()
    rig.run(**MAHLI_TOUCHED)
    done = [evr.command for evr in rig.evrs if isinstance(evr, CommandCompleted)]
    assert done == ["Retract", "MoveTool", "GuardedMove", "ToolChange"]


def test_the_tool_that_touches_is_not_changed_for_itself():
    rig = lab.guarded_in_contact()
    rig.cycle(ToolChange("apxs"), **lab.TOUCHED)
    assert rig.evrs == [CommandRefused("ToolChange", "apxs is the tool that touches")]


def test_a_taught_point_is_stood_off_along_its_approach_or_against_gravity():
    rig = lab.deployed()
    p, approach = np.array(lab.HERE.p_RoTo_R_m), np.array(lab.HERE.approach_R)
    for along_gravity, way in ((False, approach), (True, [0, 0, 1])):
        (move,) = steps_of(rig, MoveTeachPoint("here", 0.05, along_gravity=along_gravity))
        np.testing.assert_allclose(move.p_FoTo_F_m, p - 0.05 * np.array(way), atol=1e-9)
        np.testing.assert_allclose(move.approach_F, way, atol=1e-9)


def test_docking_goes_straight_on_beyond_the_taught_point_until_it_touches():
    rig = lab.deployed()
    (touch,) = steps_of(rig, Dock("here", 0.02))
    end = np.array(lab.HERE.p_RoTo_R_m) + 0.02 * np.array(lab.HERE.approach_R)
    np.testing.assert_allclose(touch.end_p_RoTo_R_m, end, atol=1e-12)
    rig.cycle(Dock("here", 0.02))
    for _ in range(40):
        rig.cycle()
    assert CommandCompleted("Dock") in rig.run(**lab.TOUCHED)
    assert rig.state.mode is Mode.GUARDED


def test_the_turret_vibrates_on_its_brakes_while_it_is_held_against_gravity():
    rig = lab.deployed()
    rig.begin(Process("portion", (1.0, 0.0, 0.2), 2.0))
    assert isinstance(rig.state.sequence.remaining[-1], Hold)
    vibrating = 0
    while rig.outputs.joint.busy:
        drive = rig.cycle().drive
        vibrating += drive.vibrate
        assert not (drive.vibrate and (drive.power_on.any() or drive.brake_release.any()))
    assert vibrating == pytest.approx(2.0 * 64, abs=2)
    assert CommandCompleted("Process") in rig.evrs


def test_relative_angles_count_from_where_the_outputs_are():
    rig = lab.deployed()
    before = rig.state.joints.output_rad
    rig.run(MoveJoints((0.01, 0.0, -0.02, 0.0, 0.03), relative=True))
    np.testing.assert_allclose(rig.state.joints.output_rad - before, [0.01, 0.0, -0.02, 0.0, 0.03], atol=2e-5)


@pytest.mark.parametrize(
    "name", [ROVER, *(frame.name.lower() for frame in Frame if frame is not Frame.TOOL), "mahli"]
)
def test_a_place_may_be_given_in_any_frame_of_the_arm_as_it_stands(name):
    rig = lab.deployed()
    X_RT = rig.tool_pose("apxs")
    frames = settle_output(
        lab.CONFIG.arm, rig.state.joints.output_rad, rig.state.joints.gravity_R_m_s2
    ).frames
    R, p = np.eye(3), np.zeros(3)
    if name == "mahli":
        X = tool_pose(lab.CONFIG.arm, frames, "mahli")
        R, p = X.R, X.p
    elif name != ROVER:
        k = Frame[name.upper()]
        R, p = frames.X_RF.R[:, :, k], frames.X_RF.p[:, k]
    wanted = X_RT.p + 0.01 * X_RT.R[:, 0]
    rig.run(MoveTool("apxs", floats(R.T @ (wanted - p)), floats(R.T @ X_RT.R[:, 0]), frame=name))
    np.testing.assert_allclose(rig.tool_pose("apxs").p, wanted, atol=3e-5)


def test_a_straight_move_keeps_the_tool_on_its_line():
    rig = lab.deployed()
    start = rig.tool_pose("apxs")
    end = start.p + np.array([0.05, 0.08, -0.04])
    rig.cycle(MoveTool("apxs", floats(end), floats(start.R[:, 0]), straight=True))
    along = (end - start.p) / np.linalg.norm(end - start.p)
    while rig.outputs.joint.busy:
        rig.cycle()
        if rig.state.tick % 32 == 0:
            off = rig.tool_pose("apxs").p - start.p
            assert np.linalg.norm(off - (off @ along) * along) < 5e-4
    np.testing.assert_allclose(rig.tool_pose("apxs").p, end, atol=3e-5)


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (MoveJoints((1.0, lab.INF, 1.0, 1.0, 1.0)), "angle_rad: number 2: inf is outside -7 .. 7"),
        (Calibrate(2.0), "joint: 2.0 is not known; there are azimuth, elevation, elbow, wrist, turret"),
        (MoveTool("apxs", (0, 0, 0), (1, 0, 0), frame="TOOL"), "frame: 'TOOL' is not known; there are rover"),
        (MoveTool("apxs", (0, 0, 0), (1, 0, 0), straight=True, branch=BRANCHES[0]), "a straight move stays"),
        (PlaceTool("portion", (2, 0, 0), (0, 0, 1)), "portion has no contact switch"),
        (MoveTeachPoint("there"), "point 'there' was not taught; there are here"),
        (Dock("there"), "point 'there' was not taught; there are here"),
    ],
)
def test_numbers_and_words_that_make_no_sense_are_refused(command, reason):
    assert lab.refusal(lab.deployed(), command).startswith(reason)
