"""Start of a run for Python users: an arm by its name, effects by their texts, and defaults for the rest."""

from collections.abc import Iterable
from typing import Final

from fsw.dictionary.types import Joints5
from fsw.estimate.reference import Reference
from sim.arms import BuiltArm, arm_named, effects_of_run
from sim.effects.effect import Effect
from sim.initialisation import true_reference
from sim.loop import ClosedLoop, Setup
from sim.scenario.effects import parse_effect_text
from sim.world import World

LEVEL_MARS: Final = World()


def start_loop(
    arm: BuiltArm | str = "nominal",
    world: World = LEVEL_MARS,
    effects: Iterable[Effect | str] = (),
    *,
    start_rad: Joints5 | None = None,
    reference: Reference | None = None,
    seed: int = 0,
    with_truth: bool = True,
) -> ClosedLoop:
    """Start a run of an arm that has found its hardstops.

    Args:
        arm: Arm or its name: nominal, as-built:SEED or calibrated:SEED; MODEL/ before it for another drawing,
            or a folder with an arm.toml.
        effects: Effects, or their texts as on the command line.
        start_rad: Output angles at the start; None for the stowed pose.
        reference: Reference in the memory of flight software; None for that of an initialisation without
            errors. `initial_reference` simulates the initialisation, which takes some seconds.
        seed: Seed of everything random but the arm.
        with_truth: True to record the state of the plant in every cycle.

    Raises:
        UnknownArm: there is no such arm.
        BadEffect: the text of an effect is wrong.
    """
    built = arm_named(arm) if isinstance(arm, str) else arm
    tools = built.params.tool_names
    added = tuple(parse_effect_text(one, tools) if isinstance(one, str) else one for one in effects)
    built = built.with_effects(added)
    start = built.params.poses.stowed_rad if start_rad is None else start_rad
    known = true_reference(built) if reference is None else reference
    return ClosedLoop(Setup(built, world, start, seed, known, effects_of_run(added)), with_truth)
