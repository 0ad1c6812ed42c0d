"""Effects of links, base and surroundings that a robot and its logs may show, with their typical sizes."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Final

import mujoco
import mujoco.batch
import numpy as np

from simgap.arrays import Array
from simgap.effects.effect import Effect, Fields, JointScales
from simgap.effects.forces import PlaneContact
from simgap.effects.inertia import GravityDirection, LinkCentre, LinkInertia, LinkLength, LinkMass, Payload
from simgap.logs import Motion
from simgap.robot import ControlMode, Robot

HEIGHT_ERROR_M: Final = 0.01
"""Joint zeros and lengths put the site of the model this far from the real tool. A plane that takes less of
the motion is not worth a name."""
INSTANTS: Final = 1000
"""Instants of a motion at which the height of the tool is computed: ten a second in a motion of 100 s."""
POSES: Final = 20
"""Random poses at which an effect must change a torque: more than the numbers of any link."""
SEEN_TORQUE: Final = 1e-6
"""Least share of the largest torque: above rounding, below anything that a log shows."""


def link_effects(robot: Robot, motions: Sequence[Motion], scales: Mapping[str, JointScales]) -> list[Effect]:
    """List payload, changes of links, gravity direction, and contact with a plane.

    Those that change no torque of any joint are left out, such as the mass of a link that turns about its own
    vertical axis.
    """
    places = [joint.name for joint in robot.joints if joint.name in scales]
    nominal_Nm = _torques_Nm(robot.model, robot, scales)
    found = [
        _with_seen_axes(robot, effect, scales) if isinstance(effect, Payload) else effect
        for effect in _candidates(robot, places)
        if _differ(nominal_Nm, _torques_with(robot, effect, scales))
    ]
    return [*found, *_contact(robot, motions)]


def _candidates(robot: Robot, places: Sequence[str]) -> Iterator[Effect]:
    model = robot.model
    body_of = {joint.name: int(model.dof_bodyid[joint.dof_index]) for joint in robot.joints}
    moved_kg = float(sum(model.body_mass[model.body_weldid != 0]))
    holder = _holder(robot, body_of)
    if holder in places:
        yield Payload(
            holder, robot.tool_site, 0.1 * moved_kg, moved_kg, _link_length_m(model, body_of[holder])
        )
    for place in places:
        body, dof = body_of[place], robot.joint(place).dof_index
        mass_kg = float(model.body_mass[body])
        if mass_kg > 0:
            smallest = float(model.body_inertia[body].min())
            yield LinkMass(place, mass_kg)
            yield LinkCentre(place, _link_length_m(model, body))
            if not robot.joint(place).is_slide:  # it turns nothing
                yield LinkInertia(place, -0.9 * smallest, float(model.dof_M0[dof] - model.dof_armature[dof]))
        for other in places:
            length_m = float(np.linalg.norm(model.body_pos[body_of[other]]))
            if int(model.body_parentid[body_of[other]]) == body and length_m > 0:
                yield LinkLength(place, other, length_m)
    if model.opt.gravity.any():
        yield GravityDirection("base")


def _holder(robot: Robot, body_of: Mapping[str, int]) -> str:
    """Return the joint that moves the tool site, or the last joint where there is no site."""
    if not robot.tool_site:
        return robot.joints[-1].name
    body = int(robot.model.site_bodyid[robot.model.site(robot.tool_site).id])
    joints = {b: name for name, b in body_of.items()}
    while body and body not in joints:
        body = int(robot.model.body_parentid[body])
    return joints.get(body, "")


def _link_length_m(model: mujoco.MjModel, body: int) -> float:
    """Return the distance to the next body, or twice that to the centre of mass of the last one."""
    children = np.flatnonzero(model.body_parentid == body)
    lengths = [float(np.linalg.norm(model.body_pos[child])) for child in children if child != body]
    radius_m = np.sqrt(model.body_inertia[body].sum() / (2 * model.body_mass[body]))
    return max(*lengths, 2 * float(np.linalg.norm(model.body_ipos[body])), 2 * float(radius_m), 0.0)


def _with_seen_axes(robot: Robot, payload: Payload, scales: Mapping[str, JointScales]) -> Payload:
    """Return a payload with the axes along which its displacement changes a torque."""
    at_site = _torques_with(robot, replace(payload, axes=""), scales)
    seen = [
        axis for axis in "xyz" if _differ(at_site, _torques_with(robot, replace(payload, axes=axis), scales))
    ]
    return replace(payload, axes="".join(seen))


def _torques_with(robot: Robot, effect: Effect, scales: Mapping[str, JointScales]) -> Array:
    """Compute torques of random motions with an effect at its typical size."""
    batch = mujoco.batch.Batch(robot.model, nsim=1, nthread=1)
    none = np.zeros((1, len(robot.joints)))
    fields = Fields(none, none, none, none, none, none, none, batch)  # these effects change the model alone
    effect.set_model(np.array([[size.typical for size in effect.sizes]]), fields, robot)
    batch.set_const()
    return _torques_Nm(batch.get_model(0), robot, scales)


def depends_on_angle(robot: Robot, place: str, scales: Mapping[str, JointScales]) -> bool:
    """Check whether a torque depends on the angle of a joint; that of a vertical first axis changes none."""
    nominal, turned = (
        _torques_Nm(robot.model, robot, scales, turn)
        for turn in ({}, {place: 0.1 * robot.joint(place).per_rad})
    )
    return _differ(nominal, turned)


def _differ(nominal_Nm: Array, changed_Nm: Array) -> bool:
    return bool(np.abs(changed_Nm - nominal_Nm).max() > SEEN_TORQUE * np.abs(nominal_Nm).max())


def _torques_Nm(
    model: mujoco.MjModel,
    robot: Robot,
    scales: Mapping[str, JointScales],
    turn_rad: Mapping[str, float] = MappingProxyType({}),
) -> Array:
    """Compute torques of random motions in the range of the logs, with joints turned further."""
    rng = np.random.default_rng(0)  # any poses would do
    data = mujoco.MjData(model)
    torques = []
    for _ in range(POSES):
        for joint in robot.joints:
            if joint.name in scales:
                s = scales[joint.name]
                data.qpos[joint.qpos_index] = rng.uniform(s.low_rad, s.high_rad) + turn_rad.get(joint.name, 0)
                data.qvel[joint.dof_index] = s.speed_rad_s * rng.uniform(-1, 1)
                data.qacc[joint.dof_index] = s.acceleration_rad_s2 * rng.uniform(-1, 1)
        mujoco.mj_inverse(model, data)
        torques.append(data.qfrc_inverse.copy())
    return np.array(torques)


def _contact(robot: Robot, motions: Sequence[Motion]) -> list[Effect]:
    """Offer a plane if the commands go well below the lowest height that was measured."""
    if not robot.tool_site or any(joint.mode is not ControlMode.POSITION for joint in robot.joints):
        return []
    if any(log.command is None for motion in motions for log in motion.joints.values()):
        return []
    commanded_m = min((_lowest_m(robot, motion, True) for motion in motions), default=0.0)
    measured_m = min((_lowest_m(robot, motion, False) for motion in motions), default=0.0)
    lost_m = measured_m - commanded_m
    if lost_m < HEIGHT_ERROR_M:
        return []
    # in some poses another point touches than the site, up to half the tool away: the site then goes lower
    tool_m = float(np.linalg.norm(robot.model.site_pos[robot.model.site(robot.tool_site).id]))
    return [PlaneContact(robot.tool_site, commanded_m, lost_m + HEIGHT_ERROR_M + 0.5 * tool_m)]


def _lowest_m(robot: Robot, motion: Motion, is_commanded: bool) -> float:
    """Return the lowest height of the tool site in a motion, as commanded or as measured."""
    logs = motion.joints.items()
    signals = {name: log.command if is_commanded and log.command else log.position for name, log in logs}
    begin_s = max(signal.time_s[0] for signal in signals.values())
    end_s = min(signal.time_s[-1] for signal in signals.values())
    data = mujoco.MjData(robot.model)
    times_s = np.linspace(begin_s, end_s, INSTANTS)
    angles = {name: np.interp(times_s, one.time_s, one.value) for name, one in signals.items()}
    lowest_m = np.inf
    for k in range(INSTANTS):
        for name, angle_rad in angles.items():
            data.qpos[robot.joint(name).qpos_index] = angle_rad[k]
        mujoco.mj_kinematics(robot.model, data)
        lowest_m = min(lowest_m, float(data.site(robot.tool_site).xpos[2]))
    return lowest_m
