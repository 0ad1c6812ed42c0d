"""Differences of flight parameters from the drawing of an arm that no built arm has."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from fsw.dictionary.params import Params, PointMass
from fsw.kinematics.arm import transform6_to_pose
from fsw.kinematics.transforms import Pose, inverse
from sim.arm_model.description import BuiltTolerances
from sim.arm_model.load import ArmModel

MOST_SIGMA: Final = 5.0
"""Largest difference in standard deviations of the tolerances of manufacture."""


def find_mismatches(params: Params, arm: ArmModel) -> Iterator[str]:
    """Yield a sentence for each difference beyond 5 sigma of the tolerances in `arm.toml`.

    A frame may turn by the tolerance of frames and of hardstops together, because a calibration cannot tell
    them apart. Parameters that are no property of the mechanism, such as speeds, may have any value.

    Args:
        params: Flight parameters.
        arm: Drawing of the arm that they are for.
    """
    drawing, sigma = arm.params, arm.description.tolerances.built
    if params.model.name != drawing.model.name:
        yield f"model: these are of the arm {params.model.name}, not of {drawing.model.name}"
        return
    if params.model.sha256 != drawing.model.sha256:
        yield f"model: the description of {drawing.model.name} has changed since they were made"
    if (params.tool_names, params.switches) != (drawing.tool_names, drawing.switches):
        yield "tools: names of tools or switches are others than those of the arm"
        return
    yield from _compare_links(params, drawing, sigma)
    for tool, drawn in zip(params.tools, drawing.tools, strict=True):
        X = transform6_to_pose(tool.transform), transform6_to_pose(drawn.transform)
        yield from _compare_frames(f"tools.{tool.name.lower()}", *X, sigma)
    yield from _compare_joints(params, drawing, sigma)


def _compare_links(params: Params, drawing: Params, sigma: BuiltTolerances) -> Iterator[str]:
    pairs = zip(params.links.in_order(), drawing.links.in_order(), strict=True)
    for k, (link, drawn) in enumerate(pairs, start=1):
        where = f"links.arm{k}"
        X = transform6_to_pose(link.transform), transform6_to_pose(drawn.transform)
        yield from _compare_frames(where, *X, sigma)
        for side in ("near", "far"):
            yield from _compare_masses(f"{where}.{side}", getattr(link, side), getattr(drawn, side), sigma)
        for axis, (ours, theirs) in enumerate(
            zip(_softness(link.compliance), _softness(drawn.compliance), strict=True)
        ):
            yield from _compare_ratio(f"{where}.compliance.{axis}", ours, theirs, sigma.stiffness_share)


def _compare_joints(params: Params, drawing: Params, sigma: BuiltTolerances) -> Iterator[str]:
    names = ("azimuth", "elevation", "elbow", "wrist", "turret")
    for name, joint, drawn in zip(names, params.joints.in_order(), drawing.joints.in_order(), strict=True):
        where = f"joints.{name}"
        for exact in ("gear_ratio", "encoder_counts_per_turn"):
            ours, theirs = getattr(joint, exact), getattr(drawn, exact)
            if ours != theirs:
                yield f"{where}.{exact}: {ours:g} is not {theirs:g}, that of the arm"
        yield from _compare_value(
            f"{where}.hardstop_rad",
            joint.hardstop_rad,
            drawn.hardstop_rad,
            np.hypot(sigma.hardstop_rad, sigma.frame_rad),
        )
        yield from _compare_ratio(
            f"{where}.backlash_rad", joint.backlash_rad, drawn.backlash_rad, sigma.backlash_share
        )
        yield from _compare_ratio(
            f"{where}.gear_stiffness_Nm_rad",
            joint.gear_stiffness_Nm_rad,
            drawn.gear_stiffness_Nm_rad,
            sigma.stiffness_share,
        )


def _compare_frames(where: str, X: Pose, drawn: Pose, sigma: BuiltTolerances) -> Iterator[str]:
    moved = inverse(drawn) @ X
    turn_rad = float(np.arccos(np.clip((np.trace(moved.R) - 1) / 2, -1.0, 1.0)))
    shift_m = float(np.abs(moved.p).max())
    for found, unit, one in (
        (turn_rad, "rad", float(np.hypot(sigma.frame_rad, sigma.hardstop_rad))),
        (shift_m, "m", sigma.frame_m),
    ):
        if found > MOST_SIGMA * one:
            yield (
                f"{where}.transform: differs from that of the arm by {found:.4g} {unit}, "
                f"more than {MOST_SIGMA * one:.4g} {unit}"
            )


def _compare_masses(where: str, lump: PointMass, drawn: PointMass, sigma: BuiltTolerances) -> Iterator[str]:
    yield from _compare_ratio(f"{where}.mass_kg", lump.mass_kg, drawn.mass_kg, sigma.mass_share)
    shift = float(np.abs(np.subtract(lump.com_m, drawn.com_m)).max())
    most = MOST_SIGMA * sigma.com_m
    if drawn.mass_kg > 0 and shift > most:
        yield f"{where}.com_m: is {shift:.4g} m from that of the arm, more than {most:.4g} m"


def _compare_value(where: str, value: float, drawn: float, sigma: float) -> Iterator[str]:
    if abs(value - drawn) > MOST_SIGMA * sigma:
        yield f"{where}: {value:g} differs from {drawn:g} of the arm by more than {MOST_SIGMA * sigma:.4g}"


def _compare_ratio(where: str, value: float, drawn: float, share: float) -> Iterator[str]:
    if value == drawn:
        return
    largest = float(np.exp(MOST_SIGMA * share))
    if min(value, drawn) <= 0 or not 1 / largest < value / drawn < largest:
        yield f"{where}: {value:g} differs from {drawn:g} of the arm by more than a factor of {largest:.3g}"


def _softness(compliance: object) -> list[float]:
    return [float(value) for value in np.diag(np.array(compliance))]
