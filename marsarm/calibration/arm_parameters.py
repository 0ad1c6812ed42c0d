"""Calibration parameters of the arm: names, expected sizes, and their effect on the arm model.

In all functions, `x` are values of the parameters, (p,), each in its unit.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from fsw.dictionary.enums import Frame, Joint
from fsw.dictionary.params import LinkParams, Params
from fsw.dictionary.types import row6, vector3
from fsw.kinematics.arm import Arm, pose_to_transform6, transform6_to_pose
from fsw.kinematics.transforms import Array, Pose, inverse, rotation_z, screw_exp
from sim.arm_model.description import BuiltTolerances
from sim.arm_model.load import default_arm
from sim.effects.effect import rotate_matrix
from sim.effects.geometry import FrameError
from sim.effects.joints import BacklashWidth, GearStiffness
from sim.effects.structure import LinkMass, LinkStiffness
from sim.plant import SCREW_AXES
from sim.tolerances import SPRING_FRAMES
from simgap import FitParameter

MASS_FRAMES: Final = (Frame.ARM2, Frame.ARM3, Frame.ARM4, Frame.ARM5, Frame.ARM6)
FIXTURE_RAD, FIXTURE_M = 1e-4, 5e-5
"""Uncertainty of the measured frame relative to the turret interface, one sigma; assumed."""
ENCODER_ZEROS: Final = tuple(6 * frame + 2 for frame in Frame if frame < len(Joint))
"""Indices of the rotations of frames Arm1 to Arm5 about z.

This z axis is the axis of the next joint, so these rotations also hold the encoder zeros.
"""

FRAME_SCREWS: Final = slice(0, 42)
GEAR_STIFFNESSES: Final = slice(42, 47)
LINK_STIFFNESSES: Final = slice(47, 52)
BACKLASHES: Final = slice(52, 57)
MASS_FACTORS: Final = slice(57, 62)
MASS_CENTRES: Final = slice(62, 77)
PARAMETER_COUNT: Final = MASS_CENTRES.stop


def _scaled(name: str, unit: str, sigma: float) -> FitParameter:
    return FitParameter(name, unit, sigma, sigma)


def arm_parameters(built: BuiltTolerances | None = None) -> tuple[FitParameter, ...]:
    """List all parameters. Prior sigmas are the manufacturing tolerances. Factors are natural logarithms.

    Args:
        built: Tolerances of manufacture; None for those of the default arm.
    """
    built = built or default_arm().description.tolerances.built
    return (
        *_frame_screws(built),
        *(_scaled(f"gear.{j.name.lower()}", "ln", built.stiffness_share) for j in Joint),
        *(_scaled(f"spring.{f.name.lower()}", "ln", built.stiffness_share) for f in SPRING_FRAMES),
        *(_scaled(f"backlash.{j.name.lower()}", "ln", built.backlash_share) for j in Joint),
        *(_scaled(f"mass.{f.name.lower()}", "ln", built.mass_share) for f in MASS_FRAMES),
        *(
            _scaled(f"centre.{f.name.lower()}.{axis}", "m", built.com_m)
            for f in MASS_FRAMES
            for axis in "xyz"
        ),
    )


def _frame_screws(built: BuiltTolerances) -> Iterator[FitParameter]:
    for frame in Frame:
        for k, axis in enumerate(SCREW_AXES):
            scale = built.frame_rad if k < 3 else built.frame_m
            sigma = scale
            if frame is Frame.TOOL:
                sigma = FIXTURE_RAD if k < 3 else FIXTURE_M
            elif 6 * frame + k in ENCODER_ZEROS:
                sigma = float(np.hypot(built.frame_rad, built.hardstop_rad))
            yield FitParameter(f"{frame.name.lower()}.{axis}", "rad" if k < 3 else "m", scale, sigma)


def params_with_values(params: Params, x: Array) -> Params:
    """Apply values to the parameters of flight software.

    Factors of backlash change the backlash widths. The measured frame Tool is not part of the arm.
    """
    factor = np.exp(x)
    for joint in Joint:
        params = GearStiffness(joint, float(factor[GEAR_STIFFNESSES][joint])).on_params(params)
        params = BacklashWidth(joint, float(factor[BACKLASHES][joint])).on_params(params)
    for k, frame in enumerate(SPRING_FRAMES):
        params = LinkStiffness(frame, float(factor[LINK_STIFFNESSES][k])).on_params(params)
    for k, frame in enumerate(MASS_FRAMES):
        shift = vector3(x[MASS_CENTRES][3 * k : 3 * k + 3])
        params = LinkMass(frame, float(factor[MASS_FACTORS][k]), shift).on_params(params)
    for frame in Frame:  # last: the frame error of Arm6 also displaces the turret's mass
        if frame is not Frame.TOOL:
            params = FrameError(frame, row6(x[6 * frame : 6 * frame + 6])).on_params(params)
    return params


def arm_with_values(nominal: Arm, x: Array, stand_in: bool) -> tuple[Arm, Pose]:
    """Apply values to the arm as arrays.

    Link springs keep their axes, as in the plant; `params_with_values` turns them with the frame. The
    difference is less than a micrometre. The mass of a stand-in turret was weighed and is not changed.

    Returns:
        The arm, and X_RD, the frame in which it is mounted: the rover frame displaced by Arm1.
    """
    factor = np.exp(x)
    near_kg, far_kg = nominal.near_kg.copy(), nominal.far_kg.copy()
    near, far, compliance = nominal.near_p_L_m.copy(), nominal.far_p_C_m.copy(), nominal.compliance.copy()
    for k, frame in enumerate(MASS_FRAMES):
        near_kg[frame] *= factor[MASS_FACTORS][k]
        far_kg[frame] *= 1.0 if frame is Frame.ARM6 and stand_in else factor[MASS_FACTORS][k]
        near[:, frame] += x[MASS_CENTRES][3 * k : 3 * k + 3]
        far[:, frame] += x[MASS_CENTRES][3 * k : 3 * k + 3]
    for k, frame in enumerate(SPRING_FRAMES):
        compliance[:, :, frame] /= factor[LINK_STIFFNESSES][k]
    turn = turret_displacement(nominal, x)
    far[:, Frame.ARM6] = turn.R @ far[:, Frame.ARM6] + turn.p
    RP_CF = nominal.RP_CF.copy()
    for frame in tuple(Frame)[1:6]:
        X_CF = nominal.X_CF[frame] @ screw_exp(x[6 * frame : 6 * frame + 6])
        RP_CF[:, :3, frame], RP_CF[:, 3, frame] = X_CF.R, X_CF.p
    X_RF = (
        Pose(rotation_z(nominal.theta_rad[0]), np.zeros(3))
        @ Pose(np.eye(3), nominal.p_LC_m[:, 0])
        @ nominal.X_CF[0]
    )
    arm = replace(
        nominal,
        RP_CF=RP_CF,
        compliance=compliance,
        near_kg=near_kg,
        far_kg=far_kg,
        carried_kg=np.cumsum((near_kg + far_kg)[::-1])[::-1],
        near_p_L_m=near,
        far_p_C_m=far,
        gear_stiffness_Nm_rad=nominal.gear_stiffness_Nm_rad * factor[GEAR_STIFFNESSES],
    )
    return arm, X_RF @ screw_exp(x[:6]) @ inverse(X_RF)


def turret_displacement(nominal: Arm, x: Array) -> Pose:
    """Compute how the frame error of Arm6 displaces the turret's own mass, in axes of the last link."""
    R_CF = Pose(nominal.X_CF.R[:, :, 5], nominal.X_CF.p[:, 5])
    return R_CF @ screw_exp(x[6 * Frame.ARM6 : 6 * Frame.ARM6 + 6]) @ inverse(R_CF)


def move_zeros_to_hardstops(params: Params, x: Array) -> tuple[Array, Params]:
    """Move encoder zeros from the frames into the hardstop angles.

    A rotation of a frame about z equals an offset of the next joint, and so of its hardstop angle. The new
    angles are valid after each hardstop has been found again.

    Returns:
        Encoder zeros [rad], (5,), and the parameters with changed hardstop angles.
    """
    zero = x[list(ENCODER_ZEROS)].copy()
    arm = params_with_values(params, x)
    for joint in Joint:
        link, name = f"arm{joint + 1}", joint.name.lower()
        turned_back = _turn_end(getattr(arm.links, link), -float(zero[joint]))
        of_joint = getattr(arm.joints, name)
        moved = replace(of_joint, hardstop_rad=float(of_joint.hardstop_rad + zero[joint]))
        arm = replace(
            arm, links=replace(arm.links, **{link: turned_back}), joints=replace(arm.joints, **{name: moved})
        )
    return zero, arm


def _turn_end(link: LinkParams, angle_rad: float) -> LinkParams:
    """Rotate the end frame of a link about z; keep its spring and masses in place."""
    end = transform6_to_pose(link.transform) @ Pose(rotation_z(np.array(angle_rad)), np.zeros(3))
    transform = pose_to_transform6(end)
    back = rotation_z(np.array(link.transform.theta_rad - transform.theta_rad))
    return replace(
        link,
        transform=transform,
        elastic_centre_m=vector3(back @ np.array(link.elastic_centre_m)),
        compliance=rotate_matrix(link.compliance, back),
        near=replace(link.near, com_m=vector3(back @ np.array(link.near.com_m))),
        far=replace(link.far, com_m=vector3(back @ np.array(link.far.com_m))),
    )
