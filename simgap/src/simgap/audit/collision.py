"""Measured poses at which the geometry of the model touches itself or the ground."""

from collections import Counter
from collections.abc import Sequence
from typing import Final

import mujoco
import numpy as np

from simgap.audit.records import Remark, RemarkKind
from simgap.audit.static import Rest
from simgap.logs import Motion
from simgap.robot import Robot

EVERY: Final = 4
"""One of so many samples is tried: contacts last longer than a fifth of a second."""
LEAST_DEPTH_M: Final = 1e-3
"""Bodies that go into each other by less may just touch."""


def find_collisions(robot: Robot, motions: Sequence[Motion], rest: Rest) -> list[Remark]:
    """Return a remark for each pair of bodies that go into each other at measured poses."""
    model, data = robot.model, mujoco.MjData(robot.model)
    if not np.any(model.geom_contype) or not np.any(model.geom_conaffinity):
        return []
    places = [robot.joint(name).qpos_index for name in rest.joints]
    count: Counter[tuple[str, str]] = Counter()
    where: dict[tuple[str, str], dict[str, None]] = {}
    tried = range(0, rest.time_s.size, EVERY)
    for row in tried:
        data.qpos[places] = rest.measured[row]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        for pair in {_bodies(model, one.geom) for one in data.contact if one.dist < -LEAST_DEPTH_M}:
            count[pair] += 1
            where.setdefault(pair, {})[motions[int(rest.motion[row])].name] = None
    return [
        Remark(
            RemarkKind.COLLISION,
            "",
            tuple(where[pair]),
            f"{pair[0]} goes into {pair[1]} in {number / len(tried):.1%} of the measured poses",
            number / len(tried),
        )
        for pair, number in count.most_common()
    ]


def _bodies(model: mujoco.MjModel, geoms: Sequence[int]) -> tuple[str, str]:
    names = sorted(model.body(int(model.geom_bodyid[geom])).name or "a body" for geom in geoms)
    return names[0], names[1]
