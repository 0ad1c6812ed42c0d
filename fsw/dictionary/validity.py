"""Validity of parameters: limits, and combinations that no arm can have."""

import math
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any, Final, get_type_hints

import numpy as np

from fsw.dictionary.params import Params, PartGeometry, RoverPart, ToolParams, Transform6
from fsw.dictionary.types import Limits, Matrix6

COMPONENT_LIMITS: Final = {"_m": Limits(-5.0, 5.0), "_1_K": Limits(-1e-4, 1e-4)}
"""Limits of the components of every vector, by the unit in its name."""
MAX_COMPLIANCE: Final = 1e-4
"""Largest component of a compliance, in rad or m per N m or N."""
MIN_LINK_M: Final = 0.2
"""Least length of upper arm and forearm; the elbow needs both."""
ORTHOGONAL_RAD: Final = {"arm2": 0.5 * math.pi, "arm3": 0.0, "arm4": 0.0, "arm5": -0.5 * math.pi, "arm6": 0.0}
"""Turn about x from each joint axis to the next in the orthogonal arm; the turn about y is 0."""
MAX_SKEW_RAD: Final = 0.02
"""Largest deviation of an axis from the orthogonal arm.

The inverse kinematics starts from the orthogonal arm, and loses roots from 0.03 on.
"""
MIN_LEAN_RAD: Final = 0.5
"""Least angle between boresight and turret axis; a turn about a parallel boresight has no effect."""
MAX_STOP_DEPTH_RAD: Final = 0.1
"""Largest distance of a hardstop below the soft limit."""
MAX_RATED_SHARE: Final = 0.5
"""Share of the rated torque of a hardstop; speed, noise and friction need the rest."""
MOST_KNOTS: Final = 120
"""Most knots of a line or of a press: an iteration of all of them takes some 2 ms, of 15.6 ms of a cycle."""
ROUNDING: Final = 1e-12
"""Relative rounding error of a symmetric matrix."""


@cache
def read_hints(kind: type) -> dict[str, Any]:
    """Return the annotation of each field of a record, with its limits."""
    return get_type_hints(kind, include_extras=True)


def check_limits(record: Any, place: str = "") -> Iterator[str]:
    """Yield a sentence for each number that is not finite or outside its limits, and for each empty range."""
    kind: type = type(record)
    hints = read_hints(kind)
    for field in fields(record):
        value, where = getattr(record, field.name), f"{place}{field.name}"
        if is_dataclass(value):
            yield from check_limits(value, f"{where}.")
            continue
        if isinstance(value, tuple) and value and is_dataclass(value[0]):
            for k, item in enumerate(value):
                yield from check_limits(item, f"{where}.{getattr(item, 'name', k)}.")
            continue
        if not all(math.isfinite(v) for v in _leaf_numbers(value)):
            yield f"{where}: must be finite, is {value}"
            continue
        for limits in getattr(hints[field.name], "__metadata__", ()):
            if isinstance(limits, Limits) and not limits.low <= value <= limits.high:
                yield f"{where}: {value} is outside {limits.low} .. {limits.high}"
        for unit, limits in COMPONENT_LIMITS.items():
            if field.name.endswith(unit) and isinstance(value, tuple):
                for k, component in enumerate(value):
                    if not limits.low <= component <= limits.high:
                        yield f"{where}.{k}: {component} is outside {limits.low} .. {limits.high}"
    for low in (field.name for field in fields(record) if "_min_" in field.name):
        high = low.replace("_min_", "_max_")
        if not getattr(record, low) < getattr(record, high):
            yield f"{place}{low}: {getattr(record, low)} is not below {high} {getattr(record, high)}"


def check_arm(params: Params) -> Iterator[str]:
    """Yield a sentence for each combination of numbers within their limits that no arm can have."""
    for field in fields(params.links):
        link, where = getattr(params.links, field.name), f"links.{field.name}"
        problem = _check_compliance(link.compliance)
        if problem is not None:
            yield f"{where}.compliance: {problem}"
        yield from _check_axes(field.name, link.transform)
    yield from _check_names(params)
    yield from _check_boresights(params.tools)
    yield from _check_poses(params)
    yield from _check_hardstops(params)
    yield from _check_homing(params)
    yield from _check_motion(params)
    yield from _check_knots(params)
    yield from _check_geometry(params)


def _check_axes(name: str, link: Transform6) -> Iterator[str]:
    """Yield a sentence for each link that is too short, or whose axes deviate from the orthogonal arm."""
    where = f"links.{name}.transform"
    if name in ("arm3", "arm4") and link.a_m < MIN_LINK_M:
        yield f"{where}.a_m: {link.a_m} is below {MIN_LINK_M}, the shortest link"
    if name not in ORTHOGONAL_RAD:
        return
    for angle, value, orthogonal in (
        ("alpha_rad", link.alpha_rad, ORTHOGONAL_RAD[name]),
        ("beta_rad", link.beta_rad, 0.0),
    ):
        if abs(value - orthogonal) > MAX_SKEW_RAD:
            nominal = f"the orthogonal arm's {orthogonal:.6g}"
            yield f"{where}.{angle}: {value} is not within {MAX_SKEW_RAD} of {nominal}"


def _check_names(params: Params) -> Iterator[str]:
    """Yield a sentence for each name that is used twice, and for each tool that is not among the tools."""
    names = params.tool_names
    if not names:
        yield "tools: is empty; an arm has at least one tool"
    for place, given in (
        ("tools", names),
        ("switches", [switch.name for switch in params.switches]),
        ("collision.rover", [part.name for part in params.collision.rover]),
    ):
        yield from (
            f"{place}: {name} is there twice" for name in sorted({n for n in given if given.count(n) > 1})
        )
    known = ", ".join(names)
    uses = [(f"switches.{switch.name}", switch.tool) for switch in params.switches]
    uses += [(f"teach.{point.name}.tool", point.tool) for point in params.teach]
    yield from (
        f"{place}: tool {tool!r} is not known; there are {known}" for place, tool in uses if tool not in names
    )


def _check_boresights(tools: tuple[ToolParams, ...]) -> Iterator[str]:
    """Yield a sentence for each tool whose boresight is nearly parallel to the turret axis."""
    for tool in tools:
        beta = tool.transform.beta_rad
        if math.asin(abs(math.cos(beta))) < MIN_LEAN_RAD:
            where = f"tools.{tool.name}.transform.beta_rad"
            yield f"{where}: {beta} brings the boresight within {MIN_LEAN_RAD} of the turret axis"


def _check_poses(params: Params) -> Iterator[str]:
    """Yield a sentence for each named pose beyond the soft limits."""
    poses = {"poses.stowed_rad": params.poses.stowed_rad, "poses.ready_rad": params.poses.ready_rad}
    poses |= {f"poses.unstow_via_rad.{k}": via for k, via in enumerate(params.poses.unstow_via_rad)}
    stops = params.hardstop
    poses |= {
        f"hardstop.{name}": getattr(stops, name) for name in ("start_rad", "park_rad", "second_start_rad")
    }
    for name, pose in poses.items():
        for field, joint, angle in zip(fields(params.joints), params.joints.in_order(), pose, strict=True):
            if not joint.soft_min_rad <= angle <= joint.soft_max_rad:
                yield (
                    f"{name}: joint {field.name}: {angle} is outside its soft limits "
                    f"{joint.soft_min_rad:.6g} .. {joint.soft_max_rad:.6g}"
                )


def _check_hardstops(params: Params) -> Iterator[str]:
    """Yield a sentence for each hardstop too near to a soft limit or too far from it, or pressed too hard.

    A motor may pass a soft limit by the margin before it is stopped.
    """
    room_rad = params.monitors.soft_limit_margin_rad
    for field, joint in zip(fields(params.joints), params.joints.in_order(), strict=True):
        low, high = joint.soft_min_rad - MAX_STOP_DEPTH_RAD, joint.soft_min_rad - room_rad
        if not low <= joint.hardstop_rad <= high:
            yield (
                f"joints.{field.name}.hardstop_rad: {joint.hardstop_rad} is not between {room_rad} and "
                f"{MAX_STOP_DEPTH_RAD} below soft_min_rad, {low:.6g} .. {high:.6g}"
            )
        most_rad = joint.upper_hardstop_rad - room_rad
        if joint.soft_max_rad > most_rad:
            yield (
                f"joints.{field.name}.soft_max_rad: {joint.soft_max_rad} is above {most_rad:.6g}, "
                f"{room_rad} below upper_hardstop_rad"
            )
        most_Nm = MAX_RATED_SHARE * joint.hardstop_rated_Nm
        if joint.hardstop_press_Nm > most_Nm:
            yield (
                f"joints.{field.name}.hardstop_press_Nm: {joint.hardstop_press_Nm} is above {most_Nm:g}, "
                f"{MAX_RATED_SHARE} of hardstop_rated_Nm"
            )


def _check_homing(params: Params) -> Iterator[str]:
    """Yield a sentence for each joint that could not be homed: no way back, or no slower second search."""
    stops = params.hardstop
    for field, joint in zip(fields(params.joints), params.joints.in_order(), strict=True):
        least_rad = joint.backlash_rad + stops.lead_rad
        if stops.retreat_rad <= least_rad:
            yield (
                f"hardstop.retreat_rad: {stops.retreat_rad} is not above {least_rad:g}, backlash of the "
                f"{field.name} and lead_rad; the joint stays on its hardstop"
            )
        coarse_rad_s = stops.coarse_speed_share * joint.speed_rad_s
        if stops.fine_speed_rad_s > coarse_rad_s:
            yield (
                f"hardstop.fine_speed_rad_s: {stops.fine_speed_rad_s} is above {coarse_rad_s:g}, the coarse "
                f"speed of the {field.name}"
            )


def _check_motion(params: Params) -> Iterator[str]:
    """Yield a sentence for each combination with which every move, or every touch, would end in a fault."""
    motion, monitors, preload = params.motion, params.monitors, params.preload
    if motion.settle_timeout_s <= motion.settle_time_s:
        yield (
            f"motion.settle_timeout_s: {motion.settle_timeout_s} is not above settle_time_s "
            f"{motion.settle_time_s}; no move would settle"
        )
    for field, joint in zip(fields(params.joints), params.joints.in_order(), strict=True):
        count_rad = 2 * math.pi / (joint.gear_ratio * joint.encoder_counts_per_turn)
        if motion.settle_error_rad < count_rad:
            yield (
                f"motion.settle_error_rad: {motion.settle_error_rad} is below {count_rad:.3g}, an encoder "
                f"count of the {field.name}; no move would settle"
            )
    if monitors.guarded_force_N <= motion.switch_force_N:
        yield (
            f"monitors.guarded_force_N: {monitors.guarded_force_N} is not above motion.switch_force_N "
            f"{motion.switch_force_N}; every touch would be a fault"
        )
    held_N = motion.switch_force_N + preload.step_N
    if held_N > preload.max_force_N:
        yield (
            f"preload.max_force_N: {preload.max_force_N} is below {held_N:g}, motion.switch_force_N and "
            "preload.step_N, with which a tool is kept in contact"
        )


def _check_knots(params: Params) -> Iterator[str]:
    """Yield a sentence for each spacing with which a piece of planning would take too long for a cycle."""
    motion, preload = params.motion, params.preload
    for name, step, longest, length in (
        ("motion.line_step_m", motion.line_step_m, "motion.line_max_m", motion.line_max_m),
        ("preload.step_N", preload.step_N, "preload.max_force_N", preload.max_force_N),
    ):
        if length > MOST_KNOTS * step:
            yield (
                f"{name}: {step} is below {length / MOST_KNOTS:.3g}, a {MOST_KNOTS}th of {longest}; a piece "
                "of planning would take longer than a cycle"
            )


def _check_geometry(params: Params) -> Iterator[str]:
    """Yield a sentence for each part without a shape, and for each box with a negative edge."""
    parts: list[tuple[str, PartGeometry | RoverPart]] = [
        (f"collision.arm.{field.name}", getattr(params.collision.arm, field.name))
        for field in fields(params.collision.arm)
    ]
    parts += [(f"tools.{tool.name}.geometry", tool.geometry) for tool in params.tools]
    parts += [(f"collision.rover.{part.name}", part) for part in params.collision.rover]
    for where, shapes in parts:
        if not shapes.capsules and not shapes.boxes:
            yield f"{where}: has neither capsules nor boxes; a part needs at least one shape"
        for k, box in enumerate(shapes.boxes):
            if min(box.half_m) <= 0:
                yield f"{where}.boxes.{k}.half_m: {box.half_m} must be positive"


def _check_compliance(compliance: Matrix6) -> str | None:
    """Return the reason why no spring has this compliance; scaled so that its diagonal is 1."""
    C = np.array(compliance)
    if np.abs(C).max() > MAX_COMPLIANCE:
        worst = C.flat[np.abs(C).argmax()]
        limits = f"{-MAX_COMPLIANCE} .. {MAX_COMPLIANCE}"
        return f"{worst} is outside {limits} (rad or m, per N m or N), no link is as soft"
    unit = np.sqrt(np.abs(np.diag(C)))
    scale = np.outer(unit, unit)
    asymmetric = np.abs(C - C.T) > ROUNDING * scale
    if np.any(asymmetric):
        row, column = np.argwhere(asymmetric)[0]
        there, across = C[row, column], C[column, row]
        return f"is not symmetric: {there} at [{row}][{column}], {across} across the diagonal"
    positive_unit = np.where(unit > 0, unit, 1.0)
    weakest = np.linalg.eigvalsh(C / np.outer(positive_unit, positive_unit)).min()
    if np.any(np.abs(C) > scale * (1 + ROUNDING)) or weakest < -ROUNDING:
        return "is not positive semidefinite: under some load the link would give way against the load"
    return None


def _leaf_numbers(value: Any) -> Iterator[float]:
    """Yield all floats of a nested tuple."""
    if isinstance(value, tuple):
        for item in value:
            yield from _leaf_numbers(item)
    elif isinstance(value, float):
        yield value
