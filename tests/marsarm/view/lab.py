"""Short runs for the tests of views: the arm moves a little, as-built, on a tilted rover."""

import numpy as np
from scipy.spatial.transform import Rotation

from fsw.dictionary.commands import MoveJoints
from fsw.dictionary.types import joints5
from sim.arms import BuiltArm, arm_named
from sim.loop import ClosedLoop, Setup
from sim.sequence import run_sequence
from sim.setting import Surface, World
from tests.sim.lab import true_reference

START_DEG = (10.0, -60.0, 100.0, -40.0, 60.0)
GOAL_DEG = (13.0, -57.0, 97.0, -36.0, 66.0)
ROCK = Surface((2.05, 0.1, -0.25), (-0.5, 0.1, -0.85))
TILTED = World(tilt_pitch_rad=0.17, tilt_roll_rad=-0.09, surface=ROCK)


def start_loop(arm: BuiltArm, world: World) -> ClosedLoop:
    """Return a loop whose flight software has the true reference."""
    start_rad = joints5(np.radians(START_DEG))
    return ClosedLoop(Setup(arm, world, start_rad, reference=true_reference(arm)), with_truth=True)


def records_of(loop: ClosedLoop):
    """Run a move of some seconds, and yield its cycles."""
    yield from run_sequence(loop, COMMANDS)


COMMANDS = (MoveJoints(joints5(np.radians(GOAL_DEG))),)
ARM = arm_named("as-built:7")


def between(frames, values, time_s):
    """Interpolate values of frames, shape (n, ...), at a time."""
    times_s = frames.samples.time_s
    at = np.clip(np.interp(time_s, times_s, np.arange(len(times_s))), 0, len(times_s) - 1)
    frame, share = int(at), at % 1.0
    after = min(frame + 1, len(times_s) - 1)
    return (1.0 - share) * values[frame] + share * values[after]


def arm_at(frames, offset, time_s, factor):
    """Compute positions, (b + 1, 3), and quaternions, (b + 1, 4), of an arm; its offsets times a factor."""
    added = factor * between(frames, offset, time_s)
    turned = Rotation.from_rotvec(added[:, 3:]) * Rotation.from_quat(between(frames, frames.q, time_s))
    return between(frames, frames.p_m, time_s) + added[:, :3], turned.as_quat()
