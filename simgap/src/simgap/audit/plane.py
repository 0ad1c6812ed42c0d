"""Contact with a plane: the tool site stops at a height although the command goes on."""

from collections.abc import Sequence

import mujoco
import numpy as np

from simgap.arrays import Array, Flags
from simgap.audit.records import Remark, RemarkKind
from simgap.audit.static import Free, Rest
from simgap.audit.stops import find_lower_stop, median_interval
from simgap.logs import Motion
from simgap.robot import ControlMode, Robot


def find_plane(
    robot: Robot, motions: Sequence[Motion], rest: Rest, free: Free, is_held: Flags
) -> tuple[list[Remark], Flags]:
    """Find a horizontal plane at which the tool site stops.

    Args:
        robot: Robot; without a tool site nothing is found.
        rest: Samples of the motions at a low rate.
        free: Their free positions.
        is_held: Samples at which a joint is held back by something else, (n,).

    Returns:
        A remark if there is a plane, and flags of the samples whose free pose is below it, (n,).
    """
    nothing: tuple[list[Remark], Flags] = ([], np.zeros(rest.time_s.size, np.bool_))
    chain = chain_joints(robot)
    if not chain or not set(chain) <= set(rest.joints):
        return nothing
    if any(robot.joint(name).mode is not ControlMode.POSITION for name in chain):
        return nothing
    columns = [rest.joints.index(name) for name in chain]
    measured = site_heights(robot, rest.joints, rest.measured)
    pose = rest.measured.copy()
    pose[:, columns] = free.position[:, columns]
    lowered = site_heights(robot, rest.joints, pose)
    use = rest.is_slow[:, columns].all(axis=1) & ~is_held
    stop = find_lower_stop(np.where(use, lowered, np.nan), measured, rest.motion, 0.0)
    if stop is None:
        return nothing
    numbers = np.unique(rest.motion[stop.is_sure])
    levels = np.array([np.median(measured[stop.is_sure & (rest.motion == k)]) for k in numbers])
    names = tuple(motions[k].name for k in numbers)
    value, interval = float(np.median(levels)), median_interval(levels)
    text = (
        f"{robot.tool_site} stops at z = {value * 1e3:.0f} mm ({interval[0] * 1e3:.0f} to "
        f"{interval[1] * 1e3:.0f}) in {len(names)} motions, while the commands go on to "
        f"{float(lowered[stop.is_sure].min()) * 1e3:.0f} mm"
    )
    with np.errstate(invalid="ignore"):
        is_below = lowered < levels.max()
    return [Remark(RemarkKind.CONTACT, "", names, text, value, interval, "m")], is_below


def chain_joints(robot: Robot) -> tuple[str, ...]:
    """Return the joints between the world and the tool site, without those that cannot raise it."""
    model = robot.model
    if not robot.tool_site:
        return ()
    body, bodies = int(model.site_bodyid[model.site(robot.tool_site).id]), set()
    while body > 0:
        bodies.add(body)
        body = int(model.body_parentid[body])
    return tuple(one.name for one in robot.joints if int(model.dof_bodyid[one.dof_index]) in bodies)


def site_heights(robot: Robot, joints: Sequence[str], q_rad: Array) -> Array:
    """Return the height of the tool site against gravity, (n,) [m]; NaN at poses (n, n_joints) with NaN."""
    model, data = robot.model, mujoco.MjData(robot.model)
    places = [robot.joint(name).qpos_index for name in joints]
    site = model.site(robot.tool_site).id
    strength = float(np.linalg.norm(model.opt.gravity))
    up = -model.opt.gravity / strength if strength > 0.0 else np.array([0.0, 0.0, 1.0])
    height = np.full(q_rad.shape[0], np.nan)
    for row in np.flatnonzero(np.isfinite(q_rad).all(axis=1)):
        data.qpos[places] = q_rad[row]
        mujoco.mj_kinematics(model, data)
        height[row] = data.site_xpos[site] @ up
    return height
