"""Placements and tool changes keep the turret above the surface: from the ready pose of the nominal arm."""

from dataclasses import replace

import numpy as np
import pytest

from fsw.collision.distance import limit_surface
from fsw.collision.geometry import TargetSurface
from fsw.config import configure
from fsw.dictionary.commands import GuardedMove, MoveTool, PlaceTool, Retract, Stow, Unstow
from fsw.dictionary.types import vector3
from fsw.estimate.joints import uninitialised_estimate
from fsw.estimate.reference import no_reference
from fsw.executive.context import check_arguments
from fsw.executive.expansion import locate_surface
from fsw.executive.planning import PlannedSequence, Start, plan_command
from fsw.kinematics.transforms import normalize
from fsw.motion.clearance import check_paths, check_touch, compute_deflected_frames
from fsw.motion.plan import Refusal, estimate_at
from fsw.motion.plan_tool import plan_retract
from fsw.motion.work import complete
from sim.arms import arm_named
from sim.frames import p_R_from_N
from tests.fsw.motion.lab import sample_closely
from tests.fsw.rig import MARS_R_m_s2, find_violation, plan_of, planned

PARAMS = arm_named("nominal").params
CONFIG = configure(PARAMS)
JOINTS = replace(
    uninitialised_estimate(CONFIG, no_reference(CONFIG)),
    motor_rad=np.array(PARAMS.poses.ready_rad),
    imu_R_m_s2=MARS_R_m_s2,
)
STEEP = PlaceTool("apxs", vector3(p_R_from_N(np.array([2.1, -0.1, -0.3]))), (0.6, 0.0, 0.8))
"""Rock so steep that the fastest branch takes the turret through it."""
INTO_THE_ROCK = "shoulder-out elbow-up wrist-down"


def plan(command, surface=None):
    surface = surface or locate_surface(CONFIG, JOINTS, "apxs", command, None)
    return complete(CONFIG, plan_command(Start(JOINTS, "apxs", surface), command))


@pytest.fixture(scope="module")
def steep():
    planned = plan(STEEP)
    assert isinstance(planned, PlannedSequence)
    return planned


def test_a_steep_rock_is_reached_from_farther_away_on_a_branch_that_is_clear(steep):
    far, near, touch = steep.commands
    assert isinstance(far, MoveTool)
    assert isinstance(touch, GuardedMove)
    assert near.branch == far.branch == "shoulder-out elbow-up wrist-up"
    np.testing.assert_allclose(
        np.array(near.p_FoTo_F_m) - far.p_FoTo_F_m, 0.25 * np.array(STEEP.approach_R), atol=1e-12
    )


def test_the_branch_into_the_rock_is_refused_with_the_part_and_its_depth():
    refusal = plan(replace(STEEP, branch=INTO_THE_ROCK))
    assert isinstance(refusal, Refusal)
    assert refusal.reason == (
        f"apxs: {INTO_THE_ROCK}: the turret would be 115 mm below the surface; 12 % of the way are "
        f"clear; on branch {INTO_THE_ROCK}, no way from up to 0.5 m above the surface is clear"
    )


def test_a_surface_that_leans_into_the_turret_is_refused():
    leaning = plan(replace(STEEP, normal_R=(0.55, 0.0, -0.84)))
    assert isinstance(leaning, Refusal)
    assert "below the surface" in leaning.reason


def test_a_normal_along_the_approach_is_refused():
    problem = check_arguments(PARAMS, replace(STEEP, normal_R=STEEP.approach_R))
    assert problem == "the normal points along the approach, not out of the surface"


def test_a_stow_near_the_rock_begins_with_a_retraction_and_the_refusal_of_a_move_names_one_that_helps(steep):
    surface = locate_surface(CONFIG, JOINTS, "apxs", STEEP, None)
    at_standoff = estimate_at(JOINTS, steep.plans[-2].end)
    stow = complete(CONFIG, plan_command(Start(at_standoff, "apxs", surface), Stow()))
    assert isinstance(stow, PlannedSequence)
    back, stowed = stow.commands
    assert isinstance(back, Retract)
    assert stowed == Stow()
    alone = plan_of(CONFIG, at_standoff, Stow())
    np.testing.assert_allclose(stow.plans[-1].end.output_rad, alone.end.output_rad, atol=1e-12)
    for branch, end in (
        (INTO_THE_ROCK, " % of the way are clear; clear after a retraction of 0.25 m"),
        ("shoulder-in elbow-up wrist-up", " % of the way are clear"),
    ):
        move = replace(steep.commands[-2], branch=branch)
        assert plan_of(CONFIG, at_standoff, move, "apxs", surface).reason.endswith(end)


def test_a_guarded_line_is_refused_if_another_part_is_lower_than_the_tool_where_it_touches(steep):
    joints, paths = estimate_at(JOINTS, steep.plans[-2].end), steep.plans[-1].paths
    flat, leaning = -np.array(STEEP.approach_R), normalize(np.array([0.55, 0.0, -0.84]))
    assert complete(CONFIG, check_touch(CONFIG, joints, paths, "apxs", flat)) is None
    assert complete(CONFIG, check_touch(CONFIG, joints, paths, "apxs", leaning)) == (
        "the turret would be 40 mm below the surface where the APXS touches it, "
        "at least 15 mm above are to be kept"
    )


def test_an_unstow_forgets_the_surface():
    surface = locate_surface(CONFIG, JOINTS, "apxs", STEEP, None)
    assert locate_surface(CONFIG, JOINTS, "apxs", Retract("apxs", 0.1), surface) is surface
    assert locate_surface(CONFIG, JOINTS, "apxs", Unstow(), surface) is None


def test_a_tool_that_touches_may_retract_wherever_a_close_look_finds_the_way_clear(steep):
    """A plane that leans more than the rock has parts above and below it at the start."""
    joints = estimate_at(JOINTS, steep.plans[-1].end)
    paths = planned(CONFIG, plan_retract(CONFIG, joints, Retract("apxs", 0.1))).paths
    frames = compute_deflected_frames(CONFIG, joints, sample_closely(paths))
    geometry, padding_m = CONFIG.collision_geometry, PARAMS.collision.padding_m
    tip_m, axis = np.array(steep.commands[-1].end_p_RoTo_R_m), np.array(STEEP.approach_R)
    sideways = normalize(np.cross(axis, [0.0, 0.0, 1.0]))
    clear = 0
    for lean_rad in np.radians(np.arange(0.0, 60.0, 4.0)):
        for across in (sideways, -sideways, np.cross(axis, sideways), -np.cross(axis, sideways)):
            normal = -np.cos(lean_rad) * axis + np.sin(lean_rad) * across
            surface = limit_surface(geometry, frames, TargetSurface(tip_m, normal, geometry.surface_radius_m))
            close = find_violation(geometry, frames, padding_m, "apxs", surface)
            if close is None:
                assert complete(CONFIG, check_paths(joints, paths, padding_m, "apxs", surface)) is None
            clear += close is None
    assert 20 < clear < 60
