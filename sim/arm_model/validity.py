"""Checks of the description of an arm that the checks of its flight parameters do not make."""

import re
from collections.abc import Iterator
from dataclasses import fields
from typing import Any, Final

from fsw.dictionary.types import AUTO
from fsw.dictionary.validity import check_limits
from fsw.kinematics.closed_form import BRANCHES
from sim.arm_model.description import LINK_PARTS, ArmDescription, BadArm, LinkDescription, Lump, Shape

MOST_HULL_M: Final = 5.0
"""Largest half length of a part of a rover."""
NO_HULL: Final = ("ground", "surface", "rock_face", "terrace", "probe")
"""Obstacles beside the rover, and shapes that worlds add to the scene."""
LEAST_STIFFNESS: Final = 1e4
"""Least stiffness of a link, in N m/rad or N/m; flight software accepts no softer one."""
NAME: Final = re.compile(r"[a-z][a-z0-9_]*")
ARM_NAME: Final = re.compile(r"[a-z0-9][a-z0-9_-]*")
OTHER_BODIES: Final = re.compile(
    r"world|rmech|arm[1-6]|link[1-5](_far)?|turret|rover(_hull)?|rock|mars_scenery"
)
"""Bodies and sites of arm and scene: no tool, and no switch, may have their names."""


def check_description(arm: ArmDescription, path: str) -> None:
    """Check the description of an arm; BadArm names each number off limits and name that leads nowhere."""
    problems = [
        *_check_numbers(arm),
        *_check_joints(arm),
        *_check_links(arm),
        *_check_names(arm),
        *_check_tools(arm),
        *_check_shapes(arm),
        *_check_teach(arm),
        *_check_rover(arm),
    ]
    if problems:
        raise BadArm("\n".join(f"{path}: {problem}" for problem in problems))


def _check_numbers(arm: ArmDescription) -> Iterator[str]:
    """Yield a sentence for each number that is not finite or outside its limits."""
    for field in fields(arm):
        value = getattr(arm, field.name)
        if field.name in ("joints", "links", "poses", "tolerances", "rover", "workspace") and value:
            yield from check_limits(value, f"{field.name}.")
        elif field.name in ("actuators", "tools", "switches"):
            for name, record in value.items():
                yield from check_limits(record, f"{field.name}.{name}.")
    hull = {} if arm.rover is None else arm.rover.hull
    lists: list[tuple[str, dict[str, Any]]] = [
        ("shapes", arm.shapes),
        ("teach", {"": arm.teach}),
        ("rover.hull", hull),
    ]
    for place, record in (one for table, records in lists for one in _places(table, records)):
        yield from check_limits(record, f"{place}.")


def _places(table: str, lists: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, records in lists.items():
        for k, record in enumerate(records):
            yield ".".join(filter(None, (table, name, str(k)))), record


def _check_joints(arm: ArmDescription) -> Iterator[str]:
    known = ", ".join(arm.actuators)
    joints = arm.joints.by_name()
    for name, joint in joints.items():
        if joint.actuator not in arm.actuators:
            yield f"joints.{name}.actuator: {joint.actuator!r} is not known; there are {known}"
        for end in joint.hardstops_rad:
            if not -7.0 <= end <= 7.0:
                yield f"joints.{name}.hardstops_rad: {end} is outside -7.0 .. 7.0"
        if not joint.hardstops_rad[1] > joint.soft_limits_rad[1]:
            yield (
                f"joints.{name}.hardstops_rad: {joint.hardstops_rad[1]} is not above the upper soft limit, "
                f"{joint.soft_limits_rad[1]}"
            )
    for pose in ("bare_hardstop_start_rad", "bare_hardstop_park_rad", "bare_hardstop_second_start_rad"):
        for (name, joint), angle in zip(joints.items(), getattr(arm.poses, pose), strict=True):
            low, high = joint.soft_limits_rad
            if not low <= angle <= high:
                limits = f"{low:.6g} .. {high:.6g}"
                yield f"poses.{pose}: joint {name}: {angle} is outside its soft limits {limits}"


def _check_links(arm: ArmDescription) -> Iterator[str]:
    for k, link in enumerate(arm.links.in_order(), start=1):
        where = f"links.arm{k}"
        if k == 1 and link.near is not None:
            yield f"{where}.near: is not used; the rover has its mass in far"
        if k > 1 and link.near is None:
            yield f"{where}.near: is missing; a link has mass on both sides of its spring"
        for side in ("near", "far"):
            lump = getattr(link, side)
            if lump is not None:
                yield from _check_inertia(f"{where}.{side}.inertia_kg_m2", lump)
        yield from _check_stiffness(f"{where}.stiffness", link, is_rigid=k == 6)


def _check_inertia(where: str, lump: Lump) -> Iterator[str]:
    small, middle, large = sorted(lump.inertia_kg_m2)
    if not 1e-6 <= small <= large <= 1e3:
        yield f"{where}: {lump.inertia_kg_m2} has a moment outside 1e-06 .. 1000.0"
    elif small + middle < large:
        yield f"{where}: {lump.inertia_kg_m2} has a moment above the sum of the others; no body has"


def _check_stiffness(where: str, link: LinkDescription, is_rigid: bool) -> Iterator[str]:
    if is_rigid and any(link.stiffness):
        yield f"{where}: is of a spring; arm6 is rigid, leave it out"
    elif not is_rigid and not all(LEAST_STIFFNESS <= k <= 1e12 for k in link.stiffness):
        limits = f"{LEAST_STIFFNESS:g} .. 1e12"
        yield f"{where}: {link.stiffness} has a number outside {limits}; only arm6 is rigid"


def _check_names(arm: ArmDescription) -> Iterator[str]:
    if not ARM_NAME.fullmatch(arm.name) or arm.name == "nominal":
        yield f"name: {arm.name!r} is no name of an arm; write small letters, digits, - and _, not nominal"
    for table, names in (("tools", arm.tools), ("switches", arm.switches)):
        for name in names:
            if not NAME.fullmatch(name):
                yield f"{table}.{name}: is no name; write small letters, digits and _, first a letter"
            elif OTHER_BODIES.fullmatch(name):
                yield f"{table}.{name}: is the name of another part; give it a name of its own"
    yield from (
        f"switches.{name}: is the name of a tool; give it a name of its own"
        for name in arm.switches
        if name in arm.tools
    )


def _check_teach(arm: ArmDescription) -> Iterator[str]:
    """Yield a sentence for each taught point that no command can go to."""
    for k, point in enumerate(arm.teach):
        if point.name in (other.name for other in arm.teach[:k]):
            yield f"teach.{k}.name: {point.name!r} is given twice; give each point a name of its own"
        if point.branch not in (AUTO, *BRANCHES):
            yield f"teach.{k}.branch: {point.branch!r} is not known; there are {AUTO}, {', '.join(BRANCHES)}"
        if not any(point.approach_R):
            yield f"teach.{k}.approach_R: {point.approach_R} has no direction"


def _check_tools(arm: ArmDescription) -> Iterator[str]:
    known = ", ".join(arm.tools)
    if not arm.tools:
        yield "tools: is empty; an arm has at least one tool"
    uses = [("instrument", arm.instrument)]
    uses += [(f"switches.{name}.tool", switch.tool) for name, switch in arm.switches.items()]
    for place, tool in uses:
        if tool not in arm.tools:
            yield f"{place}: {tool!r} is not known; there are {known}"
    if arm.instrument in arm.tools and all(switch.tool != arm.instrument for switch in arm.switches.values()):
        yield f"instrument: {arm.instrument} has no contact switch, so it cannot be placed"
    for name, tool_ in arm.tools.items():
        if not all(-1e9 <= value < 0 for value in tool_.pad_solref):
            yield f"tools.{name}.pad_solref: {tool_.pad_solref} has a number that is not negative"


def _check_shapes(arm: ArmDescription) -> Iterator[str]:
    parts = (*LINK_PARTS, *arm.tools)
    for part, shapes in arm.shapes.items():
        if part not in parts:
            yield f"shapes.{part}: is not known; there are {', '.join(parts)}"
        for k, shape in enumerate(shapes):
            yield from (f"shapes.{part}.{k}: {problem}" for problem in _check_shape(shape))
    for part in parts:
        if not any(shape.of != "plant" for shape in arm.shapes.get(part, ())):
            yield f"shapes.{part}: is missing; flight software needs at least one shape for each part"


def _check_rover(arm: ArmDescription) -> Iterator[str]:
    """Yield a sentence for each wrong part of rover and workspace."""
    for part, shapes in {} if arm.rover is None else arm.rover.hull.items():
        if not NAME.fullmatch(part) or OTHER_BODIES.fullmatch(part) or part in (*arm.tools, *NO_HULL):
            yield f"rover.hull.{part}: is no name, or that of another part; write small letters, digits, _"
        if not any(shape.of != "plant" for shape in shapes):
            yield f"rover.hull.{part}: flight software needs at least one shape for each part"
        for k, shape in enumerate(shapes):
            yield from (f"rover.hull.{part}.{k}: {problem}" for problem in _check_shape(shape, MOST_HULL_M))
    if arm.rover is not None and not arm.rover.hull:
        yield "rover.hull: is empty; give the shapes of the rover"
    if arm.workspace is not None and not arm.workspace.top_z_m < arm.workspace.bottom_z_m:
        yield f"workspace.top_z_m: {arm.workspace.top_z_m} is not above the bottom; z is down"


def _check_shape(shape: Shape, most_m: float = 1.0) -> Iterator[str]:
    if shape.kind is None or (shape.kind == "cylinder" and shape.of != "plant"):
        yield (
            "is no shape; write a capsule (from_m, to_m, radius_m), a box (centre_m, half_m) or a cylinder "
            '(centre_m, radius_m, half_length_m), which needs of = "plant"'
        )
        return
    lengths = [("radius_m", shape.radius_m), ("half_length_m", shape.half_length_m)]
    lengths += [("half_m", length) for length in shape.half_m or ()]
    for name, length in lengths:
        if length is not None and not 1e-3 <= length <= most_m:
            yield f"{name}: {length} is outside 0.001 .. {most_m}"
    if shape.turn_rad and shape.kind != "box":
        yield f"turn_rad: turns a box only; leave it out of a {shape.kind}"


def reserved_of_flight(own: dict[str, Any], shared: dict[str, Any], flight: dict[str, Any]) -> Iterator[str]:
    """Yield each place of the table `[flight]` that own tables of a drawing set, but not the shared ones."""
    for key, value in flight.items():
        if key not in own:
            continue
        if isinstance(value, dict) and isinstance(own[key], dict) and isinstance(shared.get(key), dict):
            yield from (f"{key}.{place}" for place in reserved_of_flight(own[key], shared[key], value))
        else:
            yield key
