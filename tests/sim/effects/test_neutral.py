"""Neutral amplitudes change no bit of model, flight parameters and runs."""

from functools import cache

import mujoco
import numpy as np

from fsw.dictionary.commands import MoveJoints
from sim.arms import BuiltArm, arm_named
from sim.effects.catalogue import hypotheses
from sim.effects.effect import Effect, nominal_hardware, params_with_effects
from sim.effects.environment import Ambient
from sim.initialisation import true_reference
from sim.loop import ClosedLoop, Setup
from sim.setting import Surface, World
from sim.world import build

NEUTRAL = tuple(hypothesis.effect() for hypothesis in hypotheses())
WORLD = World(surface=Surface((2.05, 0.1, -0.25), (-0.5, 0.1, -0.85)))
NOMINAL = arm_named("nominal")
CYCLES = 160
STEP = MoveJoints((0.01, -0.01, 0.01, -0.02, 0.02), relative=True)


def compile_plant(*effects: Effect) -> bytes:
    spec = build(WORLD)
    for effect in effects:
        effect.on_model(spec)
    model = spec.compile()
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return content.tobytes()


def test_model_and_flight_parameters_are_the_same() -> None:
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


def test_a_run_is_the_same_and_effects_that_are_not_neutral_do_show() -> None:
    nothing = run_move()
    assert len(set(nothing)) > CYCLES
    assert run_move(*NEUTRAL) == nothing
    for name in ("coulomb-friction:elbow", "command-delay:elbow"):
        (one,) = (hypothesis for hypothesis in hypotheses() if str(hypothesis) == name)
        assert run_move(one.typical()) != nothing
