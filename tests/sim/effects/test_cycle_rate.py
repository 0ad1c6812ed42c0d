"""Effects within a cycle, of no size, of the surroundings of the arm, and of numerical settings."""

from functools import cache, partial

import mujoco
import numpy as np
import pytest

from fsw.dictionary.commands import MoveJoints
from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.types import vector3
from helpers.marks import slow_but
from sim.arms import BuiltArm, arm_named
from sim.effects import gears
from sim.effects.catalogue import catalogue, hypotheses
from sim.effects.effect import (
    EachCycle,
    Effect,
    apply_cycle_effects,
    nominal_hardware,
    params_with_effects,
)
from sim.effects.environment import Ambient, ContactStiffness, Numerics, Slip, SurfacePosition
from sim.effects.joints import BusSag, CommandDelay, Counterbalance, FlexCable
from sim.effects.structure import LinkCreep
from sim.frames import P_NR_M
from sim.initialisation import true_reference
from sim.loop import ClosedLoop, Setup
from sim.plant import SETTLE_S, Plant
from sim.setting import Surface, World
from sim.world import build
from tests.sim import lab
from tests.sim.effects import bench
from tests.tools import tool_index

JOINT = Joint.ELEVATION
EFFECTS = (
    gears.StribeckFriction(JOINT, 30.0, 5e-3),
    gears.LoadFriction(JOINT, 0.15),
    gears.GearEfficiency(JOINT, 0.85),
    gears.TransmissionError(JOINT, 3e-4, 2e-4, turns=60),
    FlexCable(JOINT, 20.0, 6.0, transition_rad=0.02),
    Counterbalance(JOINT, 20.0, -10.0),
    gears.AsymmetricFriction(JOINT, "positive", 20.0),
    LinkCreep(Frame.ARM3, "y", 2e-5, 1.0),
)
WHOLE = 8
"""Steps of physics in a control cycle: finer than those of the plant, so that a cycle has halves."""


@cache
def reversal(effect: EachCycle | None, every: int) -> bench.TurnRecord:
    """Turn a joint forth and back: every effect here depends on what changes then."""
    effects = () if effect is None else (effect,)
    return bench.turn_joint(JOINT, *effects, seconds=2.0, every=every, steps_per_cycle=WHOLE, back=True)


SEEN = ("output_rad", "mean_A")
NOISE = np.array([1e-4, 0.02])
"""Noise of resolver and current sensor."""


@pytest.mark.parametrize("effect", slow_but(EFFECTS, EFFECTS[0]), ids=lambda effect: type(effect).__name__)
def test_looked_at_once_a_cycle_an_effect_does_what_it_does_looked_at_in_every_step(effect):
    """The remaining difference is small beside the effect, or below the noise of a sensor."""
    drawn, there, seldom = reversal(None, WHOLE), reversal(effect, 1), reversal(effect, WHOLE)
    size, remains = (
        np.sqrt([np.mean((getattr(there, what) - getattr(one, what)) ** 2) for what in SEEN])
        for one in (drawn, seldom)
    )
    assert np.all(remains < 0.15 * size + 0.02 * NOISE)


def test_every_effect_of_each_cycle_is_looked_at_here_or_its_reason_is_said():
    """Delay and voltage are defined per cycle, and grease keeps its temperature.

    The joint that would turn another one stands still here.
    """
    left = {CommandDelay, BusSag, gears.ColdFriction, gears.JointCoupling}
    assert {kind for kind in catalogue().values() if issubclass(kind, EachCycle)} == left | {
        type(e) for e in EFFECTS
    }


NEUTRAL = tuple(hypothesis.effect() for hypothesis in hypotheses())
WORLD = World(surface=Surface((2.05, 0.1, -0.25), (-0.5, 0.1, -0.85)))
NOMINAL = arm_named("nominal")
CYCLES = 96
STEP = MoveJoints((0.01, -0.01, 0.01, -0.02, 0.02), relative=True)


def compile_plant(*effects: Effect) -> bytes:
    spec = build(WORLD)
    for effect in effects:
        effect.on_model(spec)
    model = spec.compile()
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return content.tobytes()


def test_model_and_flight_parameters_are_the_same():
    assert compile_plant(*NEUTRAL) == compile_plant()
    assert params_with_effects(NEUTRAL, NOMINAL.params) == NOMINAL.params
    hardware = nominal_hardware()
    assert Ambient(20.0).on_hardware(hardware).ambient_C.tolist() == hardware.ambient_C.tolist()


@cache
def run_move(*effects: Effect) -> list[object]:
    """Return all readings and true states of a run with a move."""
    arm = BuiltArm("nominal", effects, NOMINAL.params)
    reference = true_reference(arm_named("nominal"))
    loop = ClosedLoop(Setup(arm, World(), NOMINAL.params.poses.ready_rad, 3, reference), with_truth=True)
    seen: list[object] = []
    for k in range(CYCLES):
        record = loop.cycle((STEP,) if k == 4 else ())
        s = record.sensors
        seen.append((s.encoder_count.tobytes(), s.resolver_rad.tobytes(), s.current_A.tobytes()))
        seen.append((s.gravity_R_m_s2.tobytes(), record.truth.p_RoTo_R_m.tobytes()))
    return seen


@pytest.mark.slow
def test_a_run_is_the_same_and_effects_that_are_not_neutral_do_show():
    nothing = run_move()
    assert len(set(nothing)) > CYCLES
    assert run_move(*NEUTRAL) == nothing
    for name in ("coulomb-friction:elbow", "command-delay:elbow"):
        (one,) = (hypothesis for hypothesis in hypotheses() if str(hypothesis) == name)
        assert run_move(one.typical()) != nothing


DEEP_M = 2e-4


def put_in_rock(*effects: Effect, deep_m: float = DEEP_M, calm: bool = False) -> Plant:
    """Put the pads of the APXS slightly inside a rock, at rest."""
    truth = bench.set_angles(bench.build_arm()[0], lab.READY_RAD).truth()
    normal = -truth.R_RT[tool_index("apxs")][:, 0]
    face = truth.p_RoTo_R_m[tool_index("apxs")] + P_NR_M + deep_m * normal
    world = World(surface=Surface(vector3(face), vector3(normal)))
    plant, _ = bench.build_arm(*effects, world=world, calm=calm)
    return bench.set_angles(plant, lab.READY_RAD)


def depth_m(plant: Plant) -> float:
    return float(np.mean([-contact.dist for contact in plant.data.contact]))


@pytest.mark.parametrize("offset_m", [-1e-4, 1e-4, 3e-4])
def test_a_surface_that_is_nearer_is_met_that_much_earlier(offset_m):
    assert put_in_rock().data.ncon == 2
    assert depth_m(put_in_rock()) == pytest.approx(DEEP_M, abs=1e-9)
    assert depth_m(put_in_rock(SurfacePosition(offset_m))) == pytest.approx(DEEP_M + offset_m, abs=1e-9)


@pytest.mark.parametrize("factor", [0.5, 2.0, 4.0])
def test_what_is_stiffer_gives_way_less_under_the_same_force(factor):
    """Press the braked arm into the rock by its own springs, at rest."""
    stiffness = []
    for effects in ((), (ContactStiffness(factor),)):
        plant = put_in_rock(*effects, deep_m=1e-3, calm=True)
        plant.place(lab.READY_RAD, 4.0)
        assert plant.truth().contact_force_N > 5.0
        stiffness.append(plant.truth().contact_force_N / (len(plant.data.contact) * depth_m(plant)))
    assert stiffness[1] / stiffness[0] == pytest.approx(factor, rel=0.02)


def test_a_slippery_rock_lacks_a_share_of_the_friction_under_the_pads():
    drawn, slippery = (put_in_rock(*some).data.contact.friction for some in ((), (Slip(0.4),)))
    np.testing.assert_allclose(slippery[:, :2], 0.6 * drawn[:, :2])


def test_where_there_is_no_rock_there_is_nothing_to_shift():
    drawn, shifted = (bench.build_arm(*some)[0].model for some in ((), (SurfacePosition(1e-3),)))
    assert np.array_equal(shifted.geom_pos, drawn.geom_pos)


FINER = 6


@pytest.mark.parametrize("scheme", slow_but(["implicit", "explicit"], "implicit"))
def test_the_arm_hangs_where_it_hangs_whatever_computes_it(scheme):
    drawn, other = (bench.build_arm(*effects)[0] for effects in ((), (Numerics(scheme, FINER),)))
    for plant in (drawn, other):
        plant.place(lab.READY_RAD, 8.0)
    assert other.steps_per_cycle == FINER * drawn.steps_per_cycle
    np.testing.assert_allclose(other.output_rad(), drawn.output_rad(), atol=2e-6)
    held = other.gear_torque_Nm()[Joint.ELEVATION]
    assert held == pytest.approx(drawn.gear_torque_Nm()[Joint.ELEVATION], rel=0.02)


LOADS = (
    FlexCable(Joint.ELBOW, 50.0, 0.0),
    Counterbalance(Joint.ELBOW, -94.0, 0.0),
    Counterbalance(Joint.WRIST, 0.0, -20.0),
)


@pytest.mark.parametrize("effect", LOADS, ids=str)
def test_an_arm_with_another_load_at_a_joint_is_put_at_rest_too(effect):
    rest_rad = []
    for settle_s in (SETTLE_S, 4 * SETTLE_S):
        plant, hardware = bench.build_arm(effect)
        plant.place(lab.READY_RAD, settle_s, partial(apply_cycle_effects, plant, hardware))
        assert np.abs(plant.data.qvel[plant.at.gear]).max() < 1e-5
        rest_rad.append(plant.output_rad())
    np.testing.assert_allclose(rest_rad[0], rest_rad[1], atol=1e-5)
