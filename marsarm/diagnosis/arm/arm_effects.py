"""Effects of this arm in the diagnosis: nuisances, hypotheses with families and locations, and parameters.

Nuisances are the errors left by a calibration, and friction that varies from day to day. Families and
locations are the coarser levels of a verdict. A diagnosis looks for what flight software does not know. So
its simulator begins at the arm of the flight parameters: those of a calibrated arm differ from the drawing by
more than any effect.
"""

from collections.abc import Iterator, Sequence
from enum import StrEnum
from functools import partial
from itertools import product, starmap
from typing import Any, Final

import numpy as np

from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.params import LinkParams, Params
from fsw.dictionary.types import row6, vector3
from fsw.kinematics.arm import transform6_to_pose
from fsw.kinematics.transforms import Pose, inverse, stack_poses
from marsarm.diagnosis.arm.features import (
    MOTION_CHANNELS,
    ROTATION,
    TRANSLATION,
    MotionFeatures,
    name_channel,
)
from marsarm.diagnosis.arm.rest_poses import STEP_NUMERICS
from marsarm.diagnosis.problem import LOG_UNIT, Hypothesis, Nuisance, Parameter
from sim.arm_model.load import ArmModel
from sim.effects import catalogue, environment, gears, geometry, joints, sensors, structure
from sim.effects.catalogue import effect_name, effect_place_text
from sim.effects.effect import EachMove, Effect, joint_of, link_of, params_with_effects
from sim.initialisation import DAILY_FRICTION_SIGMA
from sim.plant import SCREW_AXES, SPRING_NAMES
from sim.tolerances import IDENTIFIABLE_AXES, SPRING_FRAMES, list_frames
from simgap import Family, screw_log

NUMERICS: Final = {"time step": STEP_NUMERICS, "scheme": environment.Numerics("explicit", 6)}
"""Other numerics of the plant. The integrator is of first order, so that twice the change by half the time
step is the change to the limit of short steps; the explicit scheme, whose steps cannot be as long, has an
error of its own at 21 steps, which looks like friction at the elbow."""
COUNT_RAD: Final = 3.3e-6
"""Encoder count: the position of a set-point within a count is random but constant."""
NUMERICS_SIGMA: Final = 2.0
"""Prior sigma of numerical errors, in differences to half the time step."""
_TURN_SHIFT: Final = ({"rad": "link-angle", "m": "link-length"}, {"rad": "tool-turn", "m": "tool-offset"})
"""Effects of rotation and shift, of frames and of tools."""


class ArmFamily(StrEnum):
    """Family that this arm has besides those of any robot."""

    STRUCTURE = "structure"
    """Links and rover that bend."""


FAMILIES: Final[dict[StrEnum, tuple[type[Effect], ...]]] = {
    Family.FRICTION: (
        *(gears.CoulombFriction, gears.AsymmetricFriction, gears.ViscousFriction, gears.StribeckFriction),
        *(gears.LoadFriction, gears.ColdFriction, gears.OutputFriction, gears.GearEfficiency),
        joints.GearFriction,
    ),
    Family.TRANSMISSION: (
        *(gears.GearHysteresis, gears.TransmissionError, gears.JointCoupling),
        *(joints.BacklashWidth, joints.GearStiffness),
    ),
    Family.ACTUATION: (joints.MotorConstant, joints.ServoGain, joints.BusSag),
    Family.TIMING: (
        *(joints.CommandDelay, sensors.CurrentGain, sensors.CurrentBias, sensors.CurrentCrosstalk),
        *(sensors.EncoderScale, sensors.EncoderZero, joints.ResolverBias, sensors.ResolverScale),
        *(sensors.ResolverEccentricity, sensors.GravityDirection),
    ),
    Family.GEOMETRY: (
        *(geometry.LinkLength, geometry.LinkAngle, geometry.ToolOffset, geometry.ToolTurn),
        *(geometry.ThermalGradient, geometry.Expansion, geometry.LinkWarming, geometry.Warming),
        joints.HardstopAngle,
    ),
    ArmFamily.STRUCTURE: (
        *(structure.LinkStiffness, structure.LinkBending, structure.LinkTorsion, structure.LinkCreep),
        structure.RoverCompliance,
    ),
    Family.INERTIA: (structure.LinkMass, structure.TurretMass, structure.TurretCentre),
    Family.CONTACT: (
        *(environment.ContactStiffness, environment.SurfacePosition, environment.Slip),
        joints.HardstopStiffness,
    ),
    Family.EXTERNAL: (joints.FlexCable, joints.Counterbalance),
}

LOCATIONS: Final = (
    dict.fromkeys(("contact-stiffness", "slip", "surface-position"), "surface")
    | dict.fromkeys(("turret-mass", "turret-centre"), "turret")
    | {"bus-sag": "power bus", "gravity-direction": "imu", "rover-compliance": "rover"}
)
"""Locations of effects whose place is an axis or the whole arm."""

REST_ONLY_EFFECTS: Final = (
    *(geometry.FrameError, geometry.LinkLength, geometry.LinkAngle, geometry.ToolOffset, geometry.ToolTurn),
    *(geometry.ThermalGradient, geometry.Expansion, geometry.LinkWarming, geometry.Warming),
    *(structure.LinkStiffness, structure.LinkBending, structure.LinkTorsion, structure.LinkCreep),
    *(structure.RoverCompliance, environment.ContactStiffness, environment.SurfacePosition),
    *(environment.Slip, joints.HardstopStiffness),
)
"""Effects that influence rests or nothing; their change of motions is below the noise, and no motion of a
campaign reaches a hardstop. An effect that is not listed is simulated in motions too."""
ROUNDING: Final = 1e-9
"""Differences below this, relative or in SI, are those of floating-point numbers."""


def list_nuisances(arm: ArmModel) -> Iterator[Nuisance]:
    """Yield what a calibration of an arm leaves (sim.arms), friction of the day, and numerical errors.

    The last ones are small variations between sessions.
    """
    left = arm.description.tolerances.calibrated
    for frame, tool in list_frames(arm.params.tool_names):
        for axis in IDENTIFIABLE_AXES[frame]:
            yield _frame_nuisance(frame, tool, axis, left.frame_rad if axis < 3 else left.frame_m)
    for joint in Joint:
        yield _joint_nuisance(joint, "zero", "rad", left.hardstop_rad, joints.HardstopAngle)
        yield _joint_nuisance(joint, "gear stiffness", LOG_UNIT, left.stiffness_share, joints.GearStiffness)
        yield _joint_nuisance(joint, "friction", LOG_UNIT, DAILY_FRICTION_SIGMA, joints.GearFriction)
    for frame in SPRING_FRAMES:
        yield _joint_nuisance(
            frame, "link stiffness", LOG_UNIT, left.stiffness_share, structure.LinkStiffness
        )
    for joint in Joint:
        yield _joint_nuisance(joint, "counter", "rad", COUNT_RAD, sensors.EncoderZero)
    at_joints = product((joint.name.lower() for joint in Joint), MOTION_CHANNELS)
    channels = starmap(name_channel, (*at_joints, ("turret", ROTATION), ("turret", TRANSLATION)))
    for channel, (word, numerics) in product(channels, NUMERICS.items()):  # on or off
        yield Nuisance(
            f"{word} {channel}",
            "1",
            NUMERICS_SIGMA,
            effect=partial(lambda one, _: one, numerics),
            same_as=word,
            only_channel=channel,
        )
    for joint in Joint:
        yield _joint_nuisance(joint, "friction", LOG_UNIT, 0.01, joints.GearFriction, random_per_block=True)
        yield _joint_nuisance(
            joint, "gear stiffness", LOG_UNIT, 0.02, joints.GearStiffness, random_per_block=True
        )
        yield _joint_nuisance(joint, "current", "A", 0.003, sensors.CurrentBias, random_per_block=True)
        yield _joint_nuisance(joint, "resolver", "rad", 6e-6, joints.ResolverBias, random_per_block=True)


def _frame_nuisance(frame: Frame, tool: str | None, axis: int, sigma: float) -> Nuisance:
    """Return a rotation or a shift of a frame; the last frame has those of every tool."""
    named, unit, word = tool or frame.name.lower(), "rad" if axis < 3 else "m", SCREW_AXES[axis]
    return Nuisance(
        f"frame {named}.{word}",
        unit,
        sigma,
        effect=lambda value: geometry.FrameError(frame, row6(value * np.eye(6)[axis]), tool),
        same_as=f"{named}.{word[1]}: {_TURN_SHIFT[tool is not None][unit]}",
    )


def _joint_nuisance(
    place: Joint | Frame, word: str, unit: str, sigma: float, kind: Any, random_per_block: bool = False
) -> Nuisance:
    """Return an effect of one parameter at a joint or frame; a factor is given by its logarithm."""
    name = place.name.lower()
    return Nuisance(
        f"{word} {name} of a session" if random_per_block else f"{word} {name}",
        unit,
        sigma,
        random_per_block,
        effect=lambda value: kind(place, float(np.exp(value)) if unit == LOG_UNIT else value),
        same_as=f"{name}: {effect_name(kind)}",
    )


def locate(effect: str, place: str) -> str:
    """Return the location of an effect: its place without axis and direction, as "arm3" of "arm3.x"."""
    return LOCATIONS.get(effect) or place.removeprefix("tool.").split(".")[0]


def moves(effect: Effect, one: MotionFeatures) -> bool:
    """Check that an effect can influence a motion: at a joint if it moves, geometry never."""
    if isinstance(effect, REST_ONLY_EFFECTS):
        return False
    joint = joint_at(effect)
    return joint is None or any(segment.joint is joint for segment in one.segments)


def joint_at(effect: Effect) -> Joint | None:
    """Return the joint of an effect; None if it has none."""
    joint = getattr(effect, "joint", None)
    return None if joint is None else Joint(joint)


def list_hypotheses(
    names: Sequence[str] | None = None, tools: Sequence[str] | None = None
) -> Iterator[Hypothesis]:
    """Yield the candidate causes of these names at an arm with these tools.

    None stands for all of the catalogue, and for the tools of the default arm. Disturbances of single moves,
    and what logs record, are no candidates: an offset of the sensor of the structure looks like warming.
    """
    recorded = (EachMove, environment.Ambient, environment.StructureTemperature, sensors.StructureSensor)
    kinds = catalogue.catalogue()
    every = catalogue.hypotheses(kinds if names is None else {name: kinds[name] for name in names}, tools)
    family_of = {kind: family for family, kinds in FAMILIES.items() for kind in kinds}
    return (to_hypothesis(one, family_of[one.kind]) for one in every if not issubclass(one.kind, recorded))


def to_hypothesis(one: catalogue.EffectHypothesis, family: StrEnum) -> Hypothesis:
    """Convert an entry of the catalogue to a hypothesis; arrays keep their defaults.

    A factor with neutral value 1 is given by its logarithm, which makes it symmetric.
    """
    effect, place = effect_name(one.kind), effect_place_text(one.kind, dict(one.place)) or "arm"
    return Hypothesis(effect, place, tuple(_list_parameters(one)), family, locate(effect, place), one)


def _list_parameters(one: catalogue.EffectHypothesis) -> Iterator[Parameter]:
    for parameter in one.amplitudes:
        size = parameter.spec
        if size is None or size.neutral is None or parameter.count != 1:
            continue
        if size.neutral == 1.0 and size.low > 0.0:
            ends = float(np.log(size.low)), float(np.log(size.high))
            yield Parameter(parameter.field, LOG_UNIT, *ends, float(np.log1p(size.typical)), 0.0)
        else:
            yield Parameter(parameter.field, size.unit, size.low, size.high, size.typical, size.neutral)


def effects_of_params(params: Params, drawing: Params) -> Iterator[Effect]:
    """Yield the effects whose perfect calibration gives the parameters of an arm, by those of its drawing.

    They are frames, springs and masses of the links, frames of the tools, hardstops, backlash, stiffness and
    friction of the joints, constants of the motors and scales of the encoders. A spring has one factor.
    """
    frames = [*_frame_errors(drawing, params)]
    now = params_with_effects(frames, drawing)
    yield from frames
    for frame in Frame:
        if frame is not Frame.TOOL:
            yield from _link_effects(frame, link_of(now, frame), link_of(params, frame))
    for joint in Joint:
        yield from _joint_effects(joint, now, params)


def _frame_errors(nominal: Params, params: Params) -> Iterator[geometry.FrameError]:
    for frame, tool in list_frames(nominal.tool_names):
        X = inverse(_pose_of(nominal, frame, tool)) @ _pose_of(params, frame, tool)
        screw = screw_log(stack_poses([X]))[:, 0]
        if np.abs(screw).max() > ROUNDING:
            yield geometry.FrameError(frame, row6(screw), tool)


def _pose_of(params: Params, frame: Frame, tool: str | None) -> Pose:
    if tool is None:
        return transform6_to_pose(link_of(params, frame).transform)
    return transform6_to_pose(params.tools[params.tool_names.index(tool)].transform)


def _link_effects(frame: Frame, old: LinkParams, new: LinkParams) -> Iterator[Effect]:
    """Yield the changes of spring and mass of a link, whose frame is already the new one."""
    if frame < len(SPRING_NAMES):
        factor = float(np.trace(old.compliance) / np.trace(new.compliance))
        if abs(factor - 1.0) > ROUNDING:
            yield structure.LinkStiffness(frame, factor)
    mass = new.far.mass_kg / old.far.mass_kg if old.far.mass_kg else 1.0
    shift_m = np.array(new.far.com_m) - np.array(old.far.com_m)
    if abs(mass - 1.0) > ROUNDING or np.abs(shift_m).max() > ROUNDING:
        yield structure.LinkMass(frame, mass, vector3(shift_m))


def _joint_effects(joint: Joint, nominal: Params, params: Params) -> Iterator[Effect]:
    old, new = joint_of(nominal, joint), joint_of(params, joint)
    if new.hardstop_rad != old.hardstop_rad:
        yield joints.HardstopAngle(joint, new.hardstop_rad - old.hardstop_rad)
    if new.output_friction_Nm != old.output_friction_Nm:
        yield gears.OutputFriction(joint, new.output_friction_Nm - old.output_friction_Nm)
    if new.gear_ratio != old.gear_ratio:
        yield sensors.EncoderScale(joint, new.gear_ratio / old.gear_ratio - 1.0)
    for kind, before, after in (
        (joints.BacklashWidth, old.backlash_rad, new.backlash_rad),
        (joints.GearStiffness, old.gear_stiffness_Nm_rad, new.gear_stiffness_Nm_rad),
        (joints.HardstopStiffness, old.hardstop_stiffness_Nm_rad, new.hardstop_stiffness_Nm_rad),
        (joints.MotorConstant, old.torque_constant_Nm_A, new.torque_constant_Nm_A),
    ):
        if after != before:
            yield kind(joint, after / before)
