"""Wrong frames, springs and masses move the tools as kinematics and statics predict."""

import numpy as np
import pytest

from fsw.dictionary.enums import Frame, Joint
from fsw.kinematics.arm import build_arm, transform6_to_pose
from fsw.kinematics.chain import forward, frame_jacobian, tool_pose
from fsw.kinematics.statics import settle
from fsw.kinematics.transforms import Pose
from helpers.marks import slow_but
from sim.arms import nominal_params
from sim.effects import geometry
from sim.effects.effect import Effect
from sim.effects.sensors import EncoderZero
from sim.effects.structure import (
    LinkBending,
    LinkCreep,
    LinkMass,
    LinkStiffness,
    LinkTorsion,
    RoverCompliance,
    StandInTurret,
    TurretCentre,
    TurretMass,
)
from sim.tolerances import SPRING_FRAMES
from tests.sim import lab
from tests.sim.effects import bench
from tests.tools import tool_index

PARAMS = nominal_params()
ARM = build_arm(PARAMS)
TILTED = lab.tilted_world(15, -10, "earth")
"""Tilt at which every joint carries a load, so that every output rests on a flank."""
GRAVITY = TILTED.gravity_N_m_s2
TIMES = pytest.mark.parametrize("times", [0.5, 2.0])
TITANIUM_1_K = 8.6e-6
TOOL = "drill"

SHIFTS = [
    geometry.LinkLength(Frame.ARM1, "z", 2e-3),
    geometry.LinkLength(Frame.ARM3, "x", 2e-3),
    geometry.LinkLength(Frame.ARM6, "y", 2e-3),
    geometry.ToolOffset(TOOL, "x", 2e-3),
]
TURNS = [
    geometry.LinkAngle(Frame.ARM1, "y", 1e-3),
    geometry.LinkAngle(Frame.ARM4, "x", 1e-3),
    geometry.LinkAngle(Frame.ARM5, "z", 1e-3),
    geometry.ToolTurn(TOOL, "y", 1e-3),
]
SPRINGS = [
    LinkTorsion(Frame.ARM3, 5e-6),
    LinkTorsion(Frame.ARM4, 5e-6),
    LinkBending(Frame.ARM2, "y", 5e-6),
    LinkBending(Frame.ARM3, "z", 5e-6),
    LinkBending(Frame.ARM4, "y", 5e-6),
    LinkBending(Frame.ARM5, "z", 5e-6),
    RoverCompliance("x", 5e-6),
    RoverCompliance("y", 5e-6),
]
MASSES = [TurretMass(2.0), TurretCentre("x", 0.02), TurretCentre("z", -0.02)]


def rigid_shift_m(*effects: Effect) -> lab.Array:
    """Return the shift of the drill of the undeflected plant by these effects."""
    places = [
        bench.set_angles(bench.build_arm(*e)[0], lab.LEFT_RAD).truth().p_RoTo_R_m[tool_index(TOOL)]
        for e in ((), effects)
    ]
    return places[1] - places[0]


def jacobian() -> lab.Array:
    """Return the undeflected Jacobian of the drill for screws of the frames, (6, 6, 7)."""
    frames = forward(ARM, lab.LEFT_RAD)
    return frame_jacobian(frames, tool_pose(ARM, frames, TOOL))


@pytest.mark.parametrize("effect", [*SHIFTS, *TURNS], ids=str)
def test_a_link_or_tool_of_another_length_or_angle_moves_the_tool_by_its_jacobian(effect) -> None:
    if effect in SHIFTS:
        size, first = getattr(effect, "length_m", None) or effect.offset_m, 3
        bound_m = 1e-12
    else:
        size, first = effect.angle_rad, 0
        bound_m = 2 * effect.angle_rad**2
    expected = size * jacobian()[3:, first + "xyz".index(effect.axis), getattr(effect, "frame", Frame.TOOL)]
    np.testing.assert_allclose(rigid_shift_m(effect), expected, atol=bound_m)


@pytest.mark.parametrize("axis", ["y", "z"])
@TIMES
def test_a_link_that_is_warm_on_one_side_bends_to_an_arc(axis: str, times: float) -> None:
    """Compare with two thousand short pieces, each rotated slightly against the last."""
    length, gradient_K = 0.785, 20.0 * times
    bend = TITANIUM_1_K * gradient_K * length / geometry.WIDTH_M
    turns = bend * (np.arange(2000) + 0.5) / 2000
    along, aside = length * np.cos(turns).mean(), length * np.sin(turns).mean()
    link = nominal_params().links.arm4
    X = transform6_to_pose(link.transform)
    error = geometry.ThermalGradient(Frame.ARM4, axis, gradient_K)._error(X.R.T @ X.p, link.expansion_1_K)
    screw = np.array(error.screw)
    assert screw["xyz".index(axis)] == pytest.approx(bend)
    across = 3 + (2 if axis == "y" else 1)
    assert abs(screw[across]) == pytest.approx(aside, rel=1e-3)
    assert screw[3] == pytest.approx(along - length, abs=1e-6)
    with pytest.raises(ValueError, match="arm4 lies along x; it bends about y and z"):
        geometry.ThermalGradient(Frame.ARM4, "x", 5.0)


@TIMES
def test_an_arm_that_is_warmer_reaches_farther_by_what_flight_software_makes_of_warmth(times: float) -> None:
    warming_K, J = 40.0 * times, jacobian()
    growth = np.column_stack([ARM.expansion_F, ARM.expansion_T[:, tool_index(TOOL)]]) * warming_K
    expected = np.einsum("ijk,jk->i", J, growth)[3:]
    np.testing.assert_allclose(rigid_shift_m(geometry.Warming(warming_K)), expected, rtol=1e-3, atol=1e-9)
    one = rigid_shift_m(geometry.LinkWarming(Frame.ARM4, warming_K))
    np.testing.assert_allclose(one, J[3:, :, 3] @ growth[:, 3], rtol=1e-3, atol=1e-9)


TOLD = [
    geometry.FrameError(Frame.ARM3, (0.0022, -0.0014, 0.0026, 0.0008, -0.0012, 0.001)),
    *SHIFTS,
    *TURNS[:3],
    *SPRINGS,
    *(LinkStiffness(frame, 0.6) for frame in SPRING_FRAMES),
    *MASSES,
    *(LinkMass(frame, 1.3, (0.02, -0.03, 0.04)) for frame in [*SPRING_FRAMES[1:], Frame.ARM6]),
    *(StandInTurret(mass_kg) for mass_kg in (0.0, 8.0, 19.0)),
    geometry.ThermalGradient(Frame.ARM3, "z", 20.0),
]


@pytest.mark.parametrize("effect", slow_but(TOLD, *TOLD[::3]), ids=str)
def test_flight_software_that_is_told_of_an_effect_knows_where_the_arm_rests(effect) -> None:
    plant, _ = bench.build_arm(effect, world=TILTED, calm=True)
    lab.load(plant, lab.LEFT_RAD, duration_s=2.0, rest_s=2.0)
    there = plant.truth().p_RoTo_R_m[tool_index(TOOL)]

    def missed_m(params) -> float:
        arm = build_arm(params)
        expected = settle(arm, plant.motor_rad(), plant.backlash_rad(), GRAVITY)
        return float(np.linalg.norm(tool_pose(arm, expected.frames, TOOL).p - there))

    assert missed_m(effect.on_params(PARAMS)) < 1e-6
    assert missed_m(PARAMS) > 20 * missed_m(effect.on_params(PARAMS))


@pytest.mark.parametrize("joint", Joint)
def test_flight_software_that_is_told_of_a_lost_count_knows_where_the_tools_are(joint: Joint) -> None:
    effect = EncoderZero(joint, 3e-3)
    believed = lab.LEFT_RAD + 3e-3 * (np.arange(5) == joint)
    true, arm = forward(ARM, lab.LEFT_RAD), build_arm(effect.on_params(PARAMS))
    poses: list[Pose] = [tool_pose(ARM, true, TOOL), tool_pose(arm, forward(arm, believed), TOOL)]
    np.testing.assert_allclose(poses[1].p, poses[0].p, atol=1e-12)
    np.testing.assert_allclose(poses[1].R, poses[0].R, atol=1e-12)


def test_a_link_creeps_under_its_load_as_far_as_a_softer_link_bends_and_no_farther() -> None:
    places = []
    for effect in (None, LinkCreep(Frame.ARM3, "y", 2e-5, 2.0), LinkBending(Frame.ARM3, "y", 2e-5)):
        plant, hardware = bench.build_arm(*([effect] if effect else []), world=TILTED)
        plant.place(lab.READY_RAD, 4.0)
        seen = []
        for cycle in range(8 * lab.CYCLE_HZ):
            hardware = bench.apply_cycle_effects(plant, hardware)
            if cycle in (0, 2 * lab.CYCLE_HZ):
                seen.append(plant.truth().p_RoTo_R_m[tool_index(TOOL)])
            plant.step()
        places.append([*seen, plant.truth().p_RoTo_R_m[tool_index(TOOL)]])
    nominal, creeping, soft = np.array(places)
    way = np.linalg.norm(soft[-1] - nominal[-1])
    moved = np.linalg.norm(creeping - nominal, axis=1) / way
    assert way > 1e-4
    np.testing.assert_allclose(moved, [0.0, 1.0 - np.exp(-1.0), 1.0], atol=0.05)
