"""Effects that make the drawing the arm that flight parameters describe.

A diagnosis looks for what flight software does not know. So its simulator begins at the arm of the flight
parameters: those of a calibrated arm differ from the drawing by more than any effect.
"""

from collections.abc import Iterator

import numpy as np

from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.params import LinkParams, Params
from fsw.dictionary.types import row6, vector3
from fsw.kinematics.arm import transform6_to_pose
from fsw.kinematics.transforms import Pose, inverse, stack_poses
from sim.arms import list_frames
from sim.effects.effect import Effect
from sim.effects.flight_params import joint_of, link_of
from sim.effects.gears import OutputFriction
from sim.effects.geometry import FrameError
from sim.effects.joints import BacklashWidth, GearStiffness, HardstopAngle, HardstopStiffness
from sim.effects.motors import MotorConstant
from sim.effects.sensors import EncoderScale
from sim.effects.structure import LinkMass, LinkStiffness
from sim.params import nominal_params
from sim.plant import SPRING_NAMES
from simgap.serial_arm.chain import screw_log

ROUNDING = 1e-9
"""Differences below this, relative or in SI, are those of floating-point numbers."""


def effects_of_params(params: Params) -> tuple[Effect, ...]:
    """Return the effects whose perfect calibration gives these flight parameters.

    They are frames, springs and masses of the links, frames of the tools, hardstops, backlash, stiffness and
    friction of the joints, constants of the motors and scales of the encoders. A spring has one factor.

    Args:
        params: Flight parameters of an arm of the default drawing.

    Returns:
        Effects; none for the parameters of the drawing.
    """
    found: list[Effect] = []
    now = nominal_params()
    for effect in _frame_errors(now, params):
        found.append(effect)
        now = effect.on_params(now)
    for frame in Frame:
        if frame is not Frame.TOOL:
            found += _link_effects(frame, link_of(now, frame), link_of(params, frame))
    for joint in Joint:
        found += _joint_effects(joint, now, params)
    return tuple(found)


def _frame_errors(nominal: Params, params: Params) -> Iterator[FrameError]:
    for frame, tool in list_frames(nominal.tool_names):
        X = inverse(_pose_of(nominal, frame, tool)) @ _pose_of(params, frame, tool)
        screw = screw_log(stack_poses([X]))[:, 0]
        if np.abs(screw).max() > ROUNDING:
            yield FrameError(frame, row6(screw), tool)


def _pose_of(params: Params, frame: Frame, tool: str | None) -> Pose:
    if tool is None:
        return transform6_to_pose(link_of(params, frame).transform)
    return transform6_to_pose(params.tools[params.tool_names.index(tool)].transform)


def _link_effects(frame: Frame, old: LinkParams, new: LinkParams) -> Iterator[Effect]:
    """Yield the changes of spring and mass of a link, whose frame is already the new one."""
    if frame < len(SPRING_NAMES):
        factor = float(np.trace(old.compliance) / np.trace(new.compliance))
        if abs(factor - 1.0) > ROUNDING:
            yield LinkStiffness(frame, factor)
    mass = new.far.mass_kg / old.far.mass_kg if old.far.mass_kg else 1.0
    shift_m = np.array(new.far.com_m) - np.array(old.far.com_m)
    if abs(mass - 1.0) > ROUNDING or np.abs(shift_m).max() > ROUNDING:
        yield LinkMass(frame, mass, vector3(shift_m))


def _joint_effects(joint: Joint, nominal: Params, params: Params) -> Iterator[Effect]:
    old, new = joint_of(nominal, joint), joint_of(params, joint)
    if new.hardstop_rad != old.hardstop_rad:
        yield HardstopAngle(joint, new.hardstop_rad - old.hardstop_rad)
    if new.output_friction_Nm != old.output_friction_Nm:
        yield OutputFriction(joint, new.output_friction_Nm - old.output_friction_Nm)
    if new.gear_ratio != old.gear_ratio:
        yield EncoderScale(joint, new.gear_ratio / old.gear_ratio - 1.0)
    for kind, before, after in (
        (BacklashWidth, old.backlash_rad, new.backlash_rad),
        (GearStiffness, old.gear_stiffness_Nm_rad, new.gear_stiffness_Nm_rad),
        (HardstopStiffness, old.hardstop_stiffness_Nm_rad, new.hardstop_stiffness_Nm_rad),
        (MotorConstant, old.torque_constant_Nm_A, new.torque_constant_Nm_A),
    ):
        if after != before:
            yield kind(joint, after / before)
