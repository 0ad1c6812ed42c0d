"""Differences of flight parameters from the drawing of an arm that no built arm has."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.dictionary.params import LinkParams, Params, ToolParams
from fsw.kinematics.arm import transform6_to_pose
from fsw.kinematics.transforms import Array, Pose, inverse, rotation_z
from sim.arm_model.description import BuiltTolerances
from sim.arm_model.load import ArmModel

MOST_SIGMA: Final = 5.0
"""Largest difference in standard deviations of the tolerances of manufacture."""
ROUNDING: Final = 1e-9
"""Relative rounding error of a turned compliance."""


def find_mismatches(params: Params, arm: ArmModel) -> Iterator[str]:
    """Yield a sentence for each difference beyond 5 sigma of the tolerances in `arm.toml`.

    A frame may turn by the tolerance of frames and of hardstops together, because a calibration cannot tell
    them apart; the spring of its link turns with it. What has no tolerance must be equal:
    torque constants, gear ratios, encoders, and the shapes of tools.
    Parameters that are no property of the mechanism, such as speeds, may have any value.
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
    for k, (link, drawn) in enumerate(
        zip(params.links.in_order(), drawing.links.in_order(), strict=True), start=1
    ):
        yield from _compare_link(f"links.arm{k}", link, drawn, sigma)
    for tool, drawn_tool in zip(params.tools, drawing.tools, strict=True):
        where = f"tools.{tool.name}"
        X = transform6_to_pose(tool.transform), transform6_to_pose(drawn_tool.transform)
        yield from _compare_frames(where, *X, sigma)
        yield from _compare_exact(where, tool, drawn_tool, "geometry")
        yield from _compare_expansions(where, tool, drawn_tool, sigma)
    yield from _compare_joints(params, drawing, sigma)


def _compare_link(where: str, link: LinkParams, drawn: LinkParams, sigma: BuiltTolerances) -> Iterator[str]:
    ends = transform6_to_pose(link.transform), transform6_to_pose(drawn.transform)
    yield from _compare_frames(where, *ends, sigma)
    yield from _compare_expansions(where, link, drawn, sigma)
    # a calibration may turn the axes of a link about z, so both are compared before theta
    ours, theirs = (rotation_z(np.array(one.transform.theta_rad)) for one in (link, drawn))
    centre, drawn_centre = ours @ np.array(link.elastic_centre_m), theirs @ np.array(drawn.elastic_centre_m)
    turn_rad = _turn_sigma(sigma)
    lever_m = float(np.linalg.norm(drawn_centre - ends[1].p))
    most_m = MOST_SIGMA * (sigma.frame_m + turn_rad * lever_m)
    shift_m = float(np.abs(centre - drawn_centre).max())
    if shift_m > most_m:
        yield f"{where}.elastic_centre_m: is {shift_m:.4g} m from that of the arm, more than {most_m:.4g} m"
    for side in ("near", "far"):
        lump, drawn_lump = getattr(link, side), getattr(drawn, side)
        yield from _compare_ratio(
            f"{where}.{side}.mass_kg", lump.mass_kg, drawn_lump.mass_kg, sigma.mass_share
        )
        shift_m = float(np.abs(ours @ np.array(lump.com_m) - theirs @ np.array(drawn_lump.com_m)).max())
        most_m = MOST_SIGMA * sigma.com_m
        if drawn_lump.mass_kg > 0 and shift_m > most_m:
            yield f"{where}.{side}.com_m: is {shift_m:.4g} m from that of the arm, more than {most_m:.4g} m"
    C, drawn_C = (
        np.kron(np.eye(2), R) @ np.array(one.compliance) @ np.kron(np.eye(2), R).T
        for one, R in ((link, ours), (drawn, theirs))
    )
    yield from _compare_compliances(f"{where}.compliance", C, drawn_C, sigma)


def _compare_expansions(
    where: str, part: LinkParams | ToolParams, drawn: LinkParams | ToolParams, sigma: BuiltTolerances
) -> Iterator[str]:
    largest = float(np.exp(MOST_SIGMA * sigma.expansion_share))
    for axis, (ours, theirs) in enumerate(zip(part.expansion_1_K, drawn.expansion_1_K, strict=True)):
        if not min(theirs * largest, theirs / largest) <= ours <= max(theirs * largest, theirs / largest):
            yield (
                f"{where}.expansion_1_K.{axis}: {ours:g} differs from {theirs:g} of the arm by more than "
                f"a factor of {largest:.3g}"
            )


def _compare_compliances(where: str, C: Array, drawn: Array, sigma: BuiltTolerances) -> Iterator[str]:
    """Compare compliances; that of a drawing is diagonal."""
    softness, drawn_softness = np.diag(C), np.diag(drawn)
    for axis, (ours, theirs) in enumerate(zip(softness, drawn_softness, strict=True)):
        yield from _compare_ratio(f"{where}.{axis}.{axis}", float(ours), float(theirs), sigma.stiffness_share)
    # off the diagonal: a small turn times the difference of two axes, and the square of the turn
    turn_rad, of_one_kind = MOST_SIGMA * _turn_sigma(sigma), np.kron(np.eye(2), np.ones((3, 3)))
    most = turn_rad * np.abs(softness[:, None] - softness)
    most += turn_rad**2 * np.maximum.outer(softness, softness)
    most = most * of_one_kind + ROUNDING * np.sqrt(np.abs(np.outer(softness, softness)))
    beyond = (np.abs(C) > most) & ~np.eye(6, dtype=bool)
    for row, column in np.argwhere(np.triu(beyond)):
        yield (
            f"{where}.{row}.{column}: {C[row, column]:.4g} is not 0, that of the arm; a turn of its frame "
            f"makes {most[row, column]:.4g} at most"
        )


def _compare_joints(params: Params, drawing: Params, sigma: BuiltTolerances) -> Iterator[str]:
    pairs = zip(Joint, params.joints.in_order(), drawing.joints.in_order(), strict=True)
    for name, joint, drawn in pairs:
        where = f"joints.{name.name.lower()}"
        exact = ("gear_ratio", "encoder_counts_per_turn", "torque_constant_Nm_A", "upper_hardstop_rad")
        yield from _compare_exact(where, joint, drawn, *exact)
        yield from _compare_value(
            f"{where}.hardstop_rad", joint.hardstop_rad, drawn.hardstop_rad, _turn_sigma(sigma)
        )
        for field, share in (
            ("backlash_rad", sigma.backlash_share),
            ("gear_stiffness_Nm_rad", sigma.stiffness_share),
            ("hardstop_stiffness_Nm_rad", sigma.stiffness_share),
            ("output_friction_Nm", sigma.friction_share),
        ):
            yield from _compare_ratio(f"{where}.{field}", getattr(joint, field), getattr(drawn, field), share)


def _compare_exact(where: str, record: object, drawn: object, *names: str) -> Iterator[str]:
    for name in names:
        ours, theirs = getattr(record, name), getattr(drawn, name)
        if ours != theirs:
            values = f"{ours:g} is not {theirs:g}," if isinstance(ours, float | int) else "is not"
            yield f"{where}.{name}: {values} that of the arm"


def _turn_sigma(sigma: BuiltTolerances) -> float:
    """Return one sigma of a frame and a hardstop together."""
    return float(np.hypot(sigma.frame_rad, sigma.hardstop_rad))


def _compare_frames(where: str, X: Pose, drawn: Pose, sigma: BuiltTolerances) -> Iterator[str]:
    moved = inverse(drawn) @ X
    turn_rad = float(np.arccos(np.clip((np.trace(moved.R) - 1) / 2, -1.0, 1.0)))
    shift_m = float(np.abs(moved.p).max())
    for found, unit, one in ((turn_rad, "rad", _turn_sigma(sigma)), (shift_m, "m", sigma.frame_m)):
        if found > MOST_SIGMA * one:
            yield (
                f"{where}.transform: differs from that of the arm by {found:.4g} {unit}, "
                f"more than {MOST_SIGMA * one:.4g} {unit}"
            )


def _compare_value(where: str, value: float, drawn: float, sigma: float) -> Iterator[str]:
    if abs(value - drawn) > MOST_SIGMA * sigma:
        yield f"{where}: {value:g} differs from {drawn:g} of the arm by more than {MOST_SIGMA * sigma:.4g}"


def _compare_ratio(where: str, value: float, drawn: float, share: float) -> Iterator[str]:
    if value == drawn:
        return
    largest = float(np.exp(MOST_SIGMA * share))
    if min(value, drawn) <= 0 or not 1 / largest < value / drawn < largest:
        yield f"{where}: {value:g} differs from {drawn:g} of the arm by more than a factor of {largest:.3g}"
