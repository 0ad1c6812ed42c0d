"""Two ways to move an arm to a place: plant and flight software, or where statics leave it."""

from functools import cache

import numpy as np

from fsw.config import configure
from fsw.dictionary.commands import BacklashMode, MoveTool
from fsw.dictionary.params import Params
from fsw.dictionary.types import joints5, vector3
from fsw.estimate.reference import Reference, no_reference
from fsw.kinematics.transforms import Array, Pose
from ground.accuracy.places import Moved, Place
from sim.arms import BuiltArm
from sim.avionics import move_rng
from sim.effects.effect import EachMove, draw_move_disturbance, params_with_effects
from sim.loop import Setup, hardware_rng
from sim.params import nominal_params
from sim.pose_sequence import free_air_loop, run_and_rest
from sim.quasi_static import StaticArm, solve_quasi_static_move
from sim.world import World


def by_closed_loop(arm: BuiltArm, reference: Reference, backlash: BacklashMode) -> Moved:
    """Plant and flight software, in free air.

    The move raises RuntimeError if it does not come to its end.
    """

    def moved(place: Place) -> tuple[Pose, Array]:
        loop = free_air_loop(Setup(arm, World(), joints5(place.start_rad), place.seed, reference))
        X_RT = place.X_RT
        command = MoveTool(place.tool, vector3(X_RT.p), vector3(X_RT.R[:, 0]), backlash=backlash)
        problem = run_and_rest(loop, command)
        if problem is not None:
            raise RuntimeError(f"{arm.name}: no way to {np.degrees(place.output_rad)} deg: {problem}")
        truth, plant = loop.truth(), loop.plant
        X_RT = Pose(truth.R_RT[place.tool], truth.p_RoTo_R_m[place.tool])
        return X_RT, plant.gap_rad() / plant.half_gap_rad

    return moved


def by_statics(arm: BuiltArm, backlash: BacklashMode) -> Moved:
    """The equilibrium of the arm, its gears as the move leaves them; initialised without any error."""
    believed, true = configure(arm.params), configure(params_with_effects(arm.effects, _drawing()))
    static = StaticArm(believed, true, no_reference(believed), true.hardstop_rad - believed.hardstop_rad)
    by_chance = [effect for effect in arm.effects if isinstance(effect, EachMove)]
    gravity = World().gravity_N_m_s2

    def moved(place: Place) -> tuple[Pose, Array]:
        scatter = draw_move_disturbance(by_chance, move_rng(hardware_rng(place.seed)))
        settled = solve_quasi_static_move(
            static, place.start_rad, place.output_rad, place.tool, gravity, backlash, scatter
        )
        return settled.X_RT, settled.gap_rad / true.half_gap_rad

    return moved


@cache
def _drawing() -> Params:
    return nominal_params()
