"""Search for poses in which the joints of an arm can find their hardstops."""

from collections.abc import Callable, Iterator
from itertools import islice
from typing import Final

import numpy as np

from fsw.config import configure
from fsw.dictionary.enums import HARDSTOP_ORDER, Joint
from fsw.dictionary.types import Joints5, joints5
from fsw.executive.homing_poses import HOMED_TWICE
from fsw.kinematics.transforms import Array
from sim.arm_check import HomingRoom
from sim.arm_model.load import ArmModel
from sim.hardstop_loads import NoPlan, PoseName

HOMINGS: Final = (*HARDSTOP_ORDER, HOMED_TWICE)
STARTS: Final = 3000
"""Number of random start poses; of Curiosity about one in a thousand leads to all hardstops."""
PARKS: Final = 30
"""Number of random parking angles of each joint in each pose."""
BRANCHES: Final = 2
"""Number of these from which the search goes on: a start that is none costs little."""


def find_homing_poses(
    arm: ArmModel, progress: Callable[[float, float, str], None]
) -> dict[PoseName, Joints5]:
    """Draw start poses, and then parking angles joint by joint, until every joint can be homed.

    The elevation is homed the second time with all others at their parking angles.

    Raises:
        NoPlan: no start is one; the message names the joint at which the best one ends.
    """
    search = _Search(arm)
    for k in range(STARTS):
        progress(k, STARTS, "search for homing poses")
        start = search.draw_start()
        parked = search.park(start, 0)
        if parked is not None:
            park = joints5(parked)
            return {"start_rad": joints5(start), "park_rad": park, "second_start_rad": park}
    joint = HOMINGS[search.farthest].name.lower()
    raise NoPlan(f"joint {joint} cannot be homed in any of {STARTS} random poses; in one, {search.problem}")


class _Search:
    """Search of parking angles for one start pose after the other."""

    def __init__(self, arm: ArmModel):
        self._room, self._config = HomingRoom(arm), configure(arm.params)
        self._rng = np.random.default_rng(0)
        self.farthest = -1
        """Largest number of homings that were possible from one start."""
        self.problem = ""
        """What was in the way of the next one."""

    def draw_start(self) -> Array:
        """Draw a start pose; turret and wrist, which are homed first, are near their hardstops."""
        pose, first = self._draw_pose(), list(HARDSTOP_ORDER[:2])
        pose[first] = self._config.arm.soft_min_rad[first] + self._config.params.hardstop.pose_tolerance_rad
        return pose

    def park(self, pose_rad: Array, k: int) -> Array | None:
        """Return the pose after homing k and all later ones, or None if there is none.

        Args:
            pose_rad: Pose before homing k, shape (5,).
            k: Index into HOMINGS.
        """
        if k == len(HOMINGS):
            return pose_rad
        joint, problem = HOMINGS[k], self._find_problem_at_stop(pose_rad, HOMINGS[k])
        stop = self._at_stop(pose_rad, joint)
        problem = problem or self._room.find_way_problem(pose_rad, stop, joint)
        if problem is not None:
            if k > self.farthest:
                self.farthest, self.problem = k, problem
            return None
        for end in islice(self._draw_ends(pose_rad, stop, k), BRANCHES):
            found = self.park(end, k + 1)
            if found is not None:
                return found
        return None

    def _draw_ends(self, pose_rad: Array, stop_rad: Array, k: int) -> Iterator[Array]:
        """Draw poses with parking angles to which joint k can go from its hardstop."""
        is_second = k == len(HARDSTOP_ORDER)
        for _ in range(1 if is_second else PARKS):
            end = pose_rad if is_second else self._with(pose_rad, HOMINGS[k])
            if self._is_for_later(end, k + 1) and not self._room.find_way_problem(stop_rad, end, HOMINGS[k]):
                yield end

    def _is_for_later(self, pose_rad: Array, k: int) -> bool:
        """Return whether the next homing, and with a parked elbow the last, may end: most fail there."""
        later = HOMINGS[k : k + 1] if k <= HARDSTOP_ORDER.index(Joint.ELBOW) else HOMINGS[k:]
        return all(self._find_problem_at_stop(pose_rad, joint) is None for joint in later)

    def _find_problem_at_stop(self, pose_rad: Array, joint: Joint) -> str | None:
        stop = self._at_stop(pose_rad, joint)
        problem = self._room.find_load_problem(pose_rad, stop, joint)
        return problem or self._room.find_way_problem(stop, stop, joint)

    def _at_stop(self, pose_rad: Array, joint: Joint) -> Array:
        pose = pose_rad.copy()
        pose[joint] = self._config.hardstop_rad[joint]
        return pose

    def _with(self, pose_rad: Array, joint: Joint) -> Array:
        """Return a pose with another random angle of a joint."""
        other = pose_rad.copy()
        other[joint] = self._draw_pose()[joint]
        return other

    def _draw_pose(self) -> Array:
        arm = self._config.arm
        return self._rng.uniform(arm.soft_min_rad, arm.soft_max_rad)
