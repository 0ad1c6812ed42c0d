"""Plans of commands: the fastest valid branch, the named branch, straight lines, and reasons for refusals."""

import re
from dataclasses import replace

import numpy as np
import pytest

from fsw.dictionary.commands import GuardedMove, MoveJoints, MoveTool, Retract
from fsw.dictionary.enums import Joint
from fsw.dictionary.types import AUTO
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.ik import BranchVerdict, inverse_kinematics
from fsw.kinematics.roots import refine_roots
from fsw.kinematics.statics import settle
from fsw.motion.plan import TOO_SOFT, Compensation, Plan, Refusal, plan_joint, plan_poses, worst_limit_excess
from fsw.motion.plan_tool import plan_guarded, plan_retract
from helpers.marks import slow_but
from tests.fsw.motion.lab import gear_at_end
from tests.fsw.rig import MARS_R_m_s2, Rig, config_of, facing, floats, in_limits, plan_of, planned, pose_of
from tests.tools import TOOLS, tool_index

CONFIG = config_of()
RNG_TARGETS = 12
MEETS = 1e-8


def joints_at(pose=None):
    return Rig(CONFIG, start_rad=pose).state.joints


def targets(tool, n=RNG_TARGETS):
    """Return tool moves to targets that the arm can reach."""
    q = in_limits(CONFIG, np.random.default_rng(300 + tool_index(tool)), n, shrink=0.2)
    q[2] = np.where(np.abs(q[2]) < 0.4, 0.8, q[2])
    here = settle(CONFIG.arm, q, np.zeros_like(q), MARS_R_m_s2)
    X = tool_pose(CONFIG.arm, here.frames, tool)
    return [MoveTool(tool, floats(X[k].p), floats(X[k].R[:, 0])) for k in range(n)]


def pose_plan(joints, poses, compensation):
    return planned(CONFIG, plan_poses(joints, poses, compensation))


def seconds(plan, joints):
    return np.max(np.abs(plan.end.output_rad - joints.output_rad) / CONFIG.speed_rad_s)


@pytest.mark.parametrize("tool", TOOLS)
def test_every_reachable_target_is_planned_and_met_by_the_settled_arm(tool):
    joints = joints_at()
    for command in targets(tool):
        plan = plan_of(CONFIG, joints, command)
        assert isinstance(plan, Plan)
        X = pose_of(CONFIG.arm, plan.end.output_rad, tool, MARS_R_m_s2)
        np.testing.assert_allclose(X.p, command.p_FoTo_F_m, atol=MEETS)
        np.testing.assert_allclose(X.R[:, 0], command.approach_F, atol=MEETS)
        assert worst_limit_excess(CONFIG, plan.end.output_rad) <= 1e-9


@pytest.mark.parametrize("tool", slow_but(TOOLS, "apxs", "drt"))
def test_auto_takes_the_quickest_branch_that_a_name_could_have_chosen(tool):
    joints = joints_at()
    for command in targets(tool, 5):
        named = {name: plan_of(CONFIG, joints, replace(command, branch=name)) for name in BRANCHES}
        valid = {name: plan for name, plan in named.items() if isinstance(plan, Plan)}
        auto = plan_of(CONFIG, joints, replace(command, branch=AUTO))
        assert auto.branch in valid
        assert seconds(auto, joints) == min(seconds(plan, joints) for plan in valid.values())


def test_an_approach_need_not_have_unit_length_and_without_deflection_the_rigid_arm_meets_the_target():
    joints, command = joints_at(), targets("apxs")[0]
    long = replace(command, approach_F=floats(7.0 * np.array(command.approach_F)))
    ends = [plan_of(CONFIG, joints, one).end.motor_rad for one in (long, command)]
    np.testing.assert_allclose(*ends, atol=1e-9)
    plan = plan_of(CONFIG, joints, replace(command, deflection="off"))
    rigid = forward(CONFIG.arm, plan.end.motor_rad + plan.backlash_rad)
    np.testing.assert_allclose(tool_pose(CONFIG.arm, rigid, "apxs").p, command.p_FoTo_F_m, atol=1e-8)


def test_a_target_is_refused_if_the_line_beyond_it_cannot_be_run():
    rig = Rig(CONFIG, start_rad=facing(CONFIG, "apxs"))
    assert isinstance(plan_of(CONFIG, rig.state.joints, rig.here("apxs", line_m=0.05)), Plan)
    far = plan_of(CONFIG, rig.state.joints, rig.here("apxs", line_m=4.0))
    assert isinstance(far, Refusal)
    assert far.reason.startswith("apxs: the end of the approach: ")
    assert " out of reach by " in far.reason


def test_out_of_reach_is_refused_with_the_nearest_branch_and_the_missing_metres():
    refusal = plan_of(CONFIG, joints_at(), MoveTool("apxs", (9.0, 0.0, 0.0), (1.0, 0.0, 0.0)))
    assert isinstance(refusal, Refusal)
    match = re.fullmatch(r"apxs: the target: (.+): out of reach by ([\d.]+) m", refusal.reason)
    assert match[1] in BRANCHES
    # the largest reach from the rover's origin is 1.1 + 0.16 + 0.83 + 0.79 m and the tool
    assert 5.5 < float(match[2]) < 7.0


@pytest.mark.parametrize("name", slow_but(BRANCHES, *BRANCHES[::3]))
def test_a_named_branch_is_refused_for_its_own_reason(name):
    joints = joints_at()
    refused = 0
    for tool in TOOLS:
        for command in targets(tool, 4):
            plan = plan_of(CONFIG, joints, replace(command, branch=name))
            if isinstance(plan, Refusal):
                match = re.fullmatch(rf"{tool}: the target: {name}: (.+)", plan.reason)
                reasons = (
                    r"joint \w+: (.+ deg is|about .+ deg) outside its soft limits .+|out of reach by [\d.]+ m"
                )
                assert re.fullmatch(reasons, match[1])
                refused += 1
    assert refused > 0


def test_poses_are_met_at_the_output_gap_and_wind_up_allowed_for():
    poses = list(in_limits(CONFIG, np.random.default_rng(8), 5, shrink=0.05).T)
    joints = joints_at()
    plan = pose_plan(joints, poses, Compensation())
    # the last move may need a run-up, which is a path of its own
    assert len(plan.paths) in (5, 6)
    np.testing.assert_allclose(plan.end.output_rad, poses[-1], atol=1e-9)
    np.testing.assert_allclose(gear_at_end(CONFIG, joints, plan), plan.end.gear_rad, atol=1e-9)
    for path, nxt in zip(plan.paths[:-1], plan.paths[1:], strict=True):
        np.testing.assert_allclose(path.at(path.duration_s).motor_rad, nxt.at(0.0).motor_rad, atol=1e-9)


@pytest.mark.parametrize("motion_rad", [-1e-3, 1e-3])
def test_a_move_smaller_than_the_gap_is_planned_from_where_the_output_lies(motion_rad):
    joints = joints_at()
    pose = joints.output_rad + np.array([motion_rad, 0, 0, 0, 0])
    plan = pose_plan(joints, [pose], Compensation())
    np.testing.assert_allclose(gear_at_end(CONFIG, joints, plan), plan.end.gear_rad, atol=1e-9)
    np.testing.assert_allclose(plan.end.output_rad, pose, atol=1e-9)
    assert abs(plan.backlash_rad[0]) == pytest.approx(CONFIG.half_backlash_rad[0], abs=1e-12)


# in 17 and 63, the load at the end may or may not exceed the friction of an output
# in 1461, it falls below friction so late that the rest of the move is shorter than the gap
@pytest.mark.parametrize("seed", slow_but([*range(8), 12, 17, 63, 1461], 17))
def test_every_output_ends_on_a_known_side_of_its_gap(seed):
    start, pose = in_limits(CONFIG, np.random.default_rng([400, seed]), 2, shrink=0.05).T
    rig = Rig(CONFIG, start_rad=start)
    joints = rig.state.joints
    plan = pose_plan(joints, [pose], Compensation())
    np.testing.assert_allclose(np.abs(plan.backlash_rad), CONFIG.half_backlash_rad, atol=1e-12)
    np.testing.assert_allclose(gear_at_end(CONFIG, joints, plan), plan.end.gear_rad, atol=1e-5)
    rig.run(MoveJoints(floats(pose)))
    np.testing.assert_array_equal(rig.outputs.joint.backlash_side, np.sign(plan.backlash_rad))
    np.testing.assert_allclose(rig.state.joints.output_rad, pose, atol=2e-5)


@pytest.mark.parametrize("joint", Joint)
@pytest.mark.parametrize("end", ["min", "max"])
def test_on_its_way_to_a_known_side_no_output_leaves_its_soft_limits(joint, end):
    pose = np.array(CONFIG.params.poses.ready_rad)
    pose[joint] = getattr(CONFIG.arm, f"soft_{end}_rad")[joint]
    plan = pose_plan(joints_at(), [pose], Compensation())
    room = CONFIG.half_backlash_rad + 200 / CONFIG.arm.gear_stiffness_Nm_rad
    for path in plan.paths:
        motor = path.at(path.duration_s).motor_rad
        assert (motor >= CONFIG.arm.soft_min_rad - room).all()
        assert (motor <= CONFIG.arm.soft_max_rad + room).all()


def test_without_backlash_compensation_the_set_points_do_not_know_of_the_gap_and_the_way_is_direct():
    pose = np.array(CONFIG.params.poses.ready_rad) + 0.1
    plan = pose_plan(joints_at(), [pose], Compensation(backlash="off"))
    assert len(plan.paths) == 1
    np.testing.assert_array_equal(plan.backlash_rad, 0)
    error_rad = plan.end.output_rad - pose
    np.testing.assert_allclose(np.abs(error_rad), CONFIG.half_backlash_rad, atol=1e-12)


def test_a_line_out_of_reach_says_where_it_ends():
    """The tool points outward; inverse kinematics along the line gives the reach."""
    pose = facing(CONFIG, "apxs")
    pose[1:4] = [-0.4, 0.9, -0.9]
    rig = Rig(CONFIG, start_rad=pose)
    refusal = planned(CONFIG, plan_guarded(CONFIG, rig.state.joints, rig.touch("apxs", 0.5)))
    assert isinstance(refusal, Refusal)
    match = re.fullmatch(r"the straight move leaves the reach of the arm after ([\d.]+) m", refusal.reason)
    reached = float(match[1])
    assert 0.1 < reached < 0.5
    X, ahead_m = rig.tool_pose("apxs"), np.array([0.0, reached - 0.02, reached + 0.02])
    p = X.p[:, None] + ahead_m * X.R[:, [0]]
    axes = np.repeat(X.R[:, [0]], 3, axis=1)
    result = inverse_kinematics(CONFIG.arm, "apxs", p, axes, MARS_R_m_s2)
    branch = np.nanargmin(np.abs(result.output_rad[..., 0] - pose[:, None]).max(axis=0))
    assert list(result.verdict[branch]) == [*[BranchVerdict.VALID] * 2, BranchVerdict.OUT_OF_REACH]


@pytest.mark.parametrize("distance_m", [0.61, 4.0, 1e4, 1e9])
def test_a_line_longer_than_the_longest_is_refused_before_anything_is_planned(distance_m):
    rig, most_m = Rig(CONFIG, start_rad=facing(CONFIG, "apxs")), CONFIG.params.motion.line_max_m
    refusal = planned(CONFIG, plan_guarded(CONFIG, rig.state.joints, rig.touch("apxs", distance_m)))
    reason = f"the straight move is {distance_m:.3g} m long, the longest allowed is {most_m} m"
    assert refusal == Refusal(reason)


def turned(X, angle_rad, about=1):
    """Return the approach of a tool, turned about one of its axes."""
    side = X.R[:, 3 - about]
    return np.cos(angle_rad) * X.R[:, 0] + np.sin(angle_rad) * side


@pytest.mark.parametrize("about", [1, 2])
@pytest.mark.parametrize(("share", "refused"), [(0.98, False), (1.02, True), (10.0, True), (31.4, True)])
def test_approach_and_way_of_a_guarded_move_may_turn_so_far_from_where_the_tool_looks(share, refused, about):
    rig = Rig(CONFIG, start_rad=facing(CONFIG, "apxs"))
    X, bound = rig.tool_pose("apxs"), CONFIG.params.motion.line_turn_rad
    axis = turned(X, share * bound, about)
    off = f"is {np.degrees(share * bound):.1f} deg from where the tool looks"
    for what, command in (
        ("the approach", replace(rig.touch("apxs", 0.05), approach_R=floats(axis))),
        ("the way to the end", GuardedMove("apxs", floats(X.p + 0.05 * axis), floats(X.R[:, 0]))),
    ):
        plan = planned(CONFIG, plan_guarded(CONFIG, rig.state.joints, command))
        assert isinstance(plan, Refusal) is refused
        if refused:
            assert plan.reason == f"{what} {off}, at most {np.degrees(bound):.1f} deg are allowed"


FALSELY_OUT_OF_REACH = [
    ("portion", (0.48507177, -0.71074232, 0.07864559, -1.19383176, 0.24471724), 0.1),
    ("apxs", (-0.7812698, -1.8119781, 0.4187753, 3.3423765, 2.4556754), 0.3),
    ("drill", (-0.0786086, -1.7903838, 2.0318926, 1.0715055, 4.5379014), 0.4),
]


@pytest.mark.parametrize(
    ("tool", "pose", "length_m"), slow_but(FALSELY_OUT_OF_REACH, *FALSELY_OUT_OF_REACH[:2])
)
def test_a_line_that_can_be_followed_knot_by_knot_is_planned(tool, pose, length_m):
    rig = Rig(CONFIG, start_rad=pose)
    joints, X = rig.state.joints, rig.tool_pose(tool)
    at = joints.output_rad
    for s in np.linspace(0.0, length_m, int(200 * length_m) + 1):
        found = refine_roots(CONFIG.arm, tool, X.p + s * X.R[:, 0], X.R[:, 0], MARS_R_m_s2, at)
        if not found.converged or np.abs(found.output_rad - at).max() > 0.1:
            pytest.fail(f"cannot be followed beyond {s} m; take another example")
        at = found.output_rad
    assert worst_limit_excess(CONFIG, at) < 0
    assert isinstance(planned(CONFIG, plan_guarded(CONFIG, joints, rig.touch(tool, length_m))), Plan)


def test_a_line_beyond_a_soft_limit_names_place_joint_and_limits():
    pose = facing(CONFIG, "drill", np.pi / 2 + 0.6)
    pose[0] = CONFIG.arm.soft_max_rad[0] - 0.01
    refusals = []
    for distance in (0.1, 0.2):
        rig = Rig(CONFIG, start_rad=pose)
        for plan in (
            planned(CONFIG, plan_retract(CONFIG, rig.state.joints, Retract("drill", distance))),
            planned(CONFIG, plan_guarded(CONFIG, rig.state.joints, rig.touch("drill", distance))),
        ):
            if isinstance(plan, Refusal):
                refusals.append(plan.reason)
    assert any("m along the line, joint azimuth" in r and "outside its soft limits" in r for r in refusals)


def test_a_line_of_no_length_is_refused():
    rig = Rig(CONFIG)
    joints = rig.state.joints
    touch = plan_guarded(CONFIG, joints, rig.touch("apxs", 0.0))
    back = plan_retract(CONFIG, joints, Retract("apxs", 0.0))
    assert touch == back == Refusal("the straight move has no length")


@pytest.mark.parametrize("softer", [100.0, 1e6])
def test_no_move_is_planned_for_an_arm_too_soft_to_come_to_rest(softer):
    joints, soft = (
        joints_at(),
        replace(CONFIG, arm=replace(CONFIG.arm, compliance=softer * CONFIG.arm.compliance)),
    )
    pose = joints.output_rad
    one = planned(soft, plan_joint(joints, Joint.WRIST, pose[Joint.WRIST], Compensation()))
    assert one == planned(soft, plan_poses(joints, [pose], Compensation())) == Refusal(TOO_SOFT)


def test_a_target_with_its_approach_along_the_pitch_axes_is_refused_with_the_nearest_regular_approach():
    X = pose_of(CONFIG.arm, facing(CONFIG, "drill", np.pi / 2, [0.3, -0.8, 1.5, 1.0, 0.0]), "drill")
    command = MoveTool("drill", floats(X.p), floats(X.R[:, 0]), branch=BRANCHES[0], deflection="off")
    refusal = plan_of(CONFIG, joints_at(), command)
    assert isinstance(refusal, Refusal)
    what, words = refusal.reason.split("; the nearest regular approach in RMECH is ")
    assert "singular" in what
    regular = floats(np.array(words.split(), float))
    assert isinstance(plan_of(CONFIG, joints_at(), replace(command, approach_F=regular)), Plan)
