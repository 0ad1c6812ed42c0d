"""An arm in the middle of what it does, and the readings that trouble it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from fsw.dictionary.commands import MoveJoints
from fsw.dictionary.evrs import FaultResponse
from fsw.motion.paths import Setpoint
from fsw.protect.responses import Response
from tests.fsw.rig import Rig, config_of, facing, floats, made_once
from tests.tools import SWITCHES

CONFIG = config_of()
BOUNDS = CONFIG.params.monitors
DRIFT_COUNT = 50
"""Drift of an encoder in a cycle that is plausible beside the motion of its motor."""
START = facing(CONFIG, "apxs")
REFUSED = FaultResponse(Response.BRAKE_AND_REFUSE)
UNPOWERED = FaultResponse(Response.POWER_OFF)
STOPPED = FaultResponse(Response.STOP_AND_BRAKE)


def heat(rig, joint, winding_C):
    """A winding that heats or cools by what is plausible in a cycle."""
    step_K = 0.999 * BOUNDS.winding_step_K
    rig.winding_C = rig.winding_C.copy()
    rig.winding_C[joint] += np.clip(winding_C - rig.winding_C[joint], -step_K, step_K)
    return {}


def closed(*switches):
    return {"switch_closed": np.isin(SWITCHES, switches)}


def currents(joint, ampere):
    return {"current_A": np.where(np.arange(5) == joint, ampere, 0.0)}


@made_once
def moving(command=None):
    rig = Rig(CONFIG, start_rad=START)
    rig.until_moving(command or MoveJoints(floats(START + 0.05)))
    return rig


@made_once
def in_guarded_motion(tool="apxs"):
    rig = Rig(CONFIG, start_rad=facing(CONFIG, tool))
    rig.until_moving(rig.touch(tool, 0.05), cycles=240)  # past the crossing of the gaps
    return rig


def braked(rig):
    drive = rig.outputs.drive
    return not drive.brake_release.any() and not drive.setpoint_rate_rad_s.any()


def found(rig, kind):
    return [evr for evr in rig.evrs if isinstance(evr, kind)]


def off_set_point(rig, joint, rad):
    """A reading of the encoders that drifts to this far from the set-point of the last cycle."""
    shift = np.where(np.arange(5) == joint, rad / CONFIG.rad_per_count, 0)
    drift = np.clip(shift - rig.off_count, -DRIFT_COUNT, DRIFT_COUNT)
    rig.off_count = rig.off_count + drift
    return {"encoder_count": rig.count + np.rint(rig.off_count).astype(int)}


def with_limit_at(rig, joint, angle_rad):
    """Protection believes that a joint may go no farther than this."""
    protection = rig.config.protection
    highest_rad = np.where(np.arange(5) == joint, angle_rad, protection.highest_rad)
    monitored = (*highest_rad.tolist(), *protection.monitored_highest[5:])
    protection = replace(protection, highest_rad=highest_rad, monitored_highest=monitored)
    rig.config = replace(rig.config, protection=protection)
    return {}


def resolver_off(rig, joint, off_rad):
    return {"resolver_rad": rig.resolver_rad() + off_rad * (np.arange(5) == joint)}


def skip(rig, cycles=BOUNDS.missed_cycles + 1):
    """Run a cycle after so many that flight software missed, and the next, which confirms it."""
    rig.cycles += cycles
    rig.cycle()
    return rig.cycle()


def misplanned(rig, setpoint_rad):
    """The state with a path that asks for this: an error of planning."""
    wrong = SimpleNamespace(duration_s=10.0, at=lambda _: Setpoint(setpoint_rad, np.zeros(5)))
    move = rig.state.move
    return replace(rig.state, move=replace(move, plan=replace(move.plan, paths=(wrong,)), ticks=0))
