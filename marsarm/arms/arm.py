"""Arms of the project: their numbers, their frames as table and picture, and files made from arm.toml."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import degrees
from pathlib import Path
from typing import Any, Final

import numpy as np

from fsw.collision.distance import place_shapes
from fsw.config import Config, configure
from fsw.dictionary.enums import Frame, Joint
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.transforms import Array, Pose
from marsarm.common.options import ArmRequest
from marsarm.render import svg
from marsarm.render.rover_scene import draw_outlines, project_outlines
from sim.arm_check import check_arm
from sim.arm_model.description import BadArm
from sim.arm_model.load import ArmModel, arm_folder, arm_names, default_arm, load_arm
from sim.params import BadParams, params_table
from simgap.common.errors import BadRequest
from simgap.common.files import atomic_write, check_output
from simgap.common.options import check_options
from simgap.common.report import ReportTable
from simgap.common.toml import toml_text

MADE_FROM: Final = "Made from arm.toml by `marsarm arm --build`; change that file, not this one."


@dataclass(frozen=True, slots=True)
class ArmFiles:
    """Arm with the files that are made from its description."""

    model: ArmModel
    texts: dict[Path, str]

    @property
    def stale(self) -> tuple[Path, ...]:
        """Return the files that are missing or have another text."""
        return tuple(
            path
            for path, text in self.texts.items()
            if not path.is_file() or path.read_bytes() != text.encode()
        )


def build_arms(request: ArmRequest) -> tuple[ArmFiles, ...]:
    """Make the files of one arm or all, and write changed ones; BadRequest if an arm is wrong."""
    try:
        names = arm_names() if request.arm is None else (request.arm,)
        found = tuple(make_files(name) for name in names)
    except (BadArm, BadParams) as error:
        raise BadRequest(str(error)) from error
    stale = {path: one.texts[path] for one in found for path in one.stale}
    for path in stale:
        check_output(path, (path.suffix,), "file")
    for path, text in stale.items():
        with atomic_write(path, "file") as file:
            file.write(text.encode())
    return found


def make_files(name: str) -> ArmFiles:
    """Make the files of an arm, unwritten; BadArm or BadParams if it cannot be used."""
    model, folder = load_arm(name), arm_folder(name)
    check_arm(model)
    comments = [f"Flight parameters of the drawing of {model.description.title}.", MADE_FROM, "SI units."]
    return ArmFiles(
        model,
        {
            folder / "arm.xml": f"<!-- {MADE_FROM} -->\n{model.mjcf}",
            folder / "flight.toml": toml_text(params_table(model.params), comments),
        },
    )


def describe_arm(model: ArmModel) -> dict[str, Any]:
    """Describe an arm in a few numbers."""
    links = model.description.links.in_order()
    mass_kg = sum(link.far.mass_kg + (0.0 if link.near is None else link.near.mass_kg) for link in links)
    return {
        "name": model.name,
        "title": model.description.title,
        "upper_arm_m": links[2].transform.a_m,
        "forearm_m": links[3].transform.a_m,
        "mass_kg": round(mass_kg, 6),
        "tools": [*model.params.tool_names],
        "instrument": model.description.instrument,
        "sha256": model.params.model.sha256,
        "is_default": model.name == default_arm().name,
    }


def arms_table(models: Iterable[ArmModel]) -> ReportTable:
    """Show a line for each arm."""
    rows = []
    for model in models:
        described = describe_arm(model)
        numbers = [f"{described[key]:g}" for key in ("upper_arm_m", "forearm_m", "mass_kg")]
        name = model.name + (" (default)" if described["is_default"] else "")
        rows.append((name, model.description.title, *numbers, " ".join(described["tools"])))
    return ReportTable(("arm", "title", "upper arm m", "forearm m", "kg", "tools"), rows)


LINK_NAMES: Final = tuple(frame.name.lower() for frame in list(Frame)[:-1])
TRANSFORM: Final = ("theta_rad", "d_m", "beta_rad", "b_m", "alpha_rad", "a_m")
JOINT_KEYS: Final = ("soft_min_rad", "soft_max_rad", "hardstop_rad", "gear_ratio", "backlash_rad")
TRIAD_M: Final = 0.11
"""Length of the axes of a frame in the picture."""
MARGIN_M: Final = 0.35
"""Distance that a view shows beyond the frames."""
AXES: Final = (("x", svg.RED), ("y", svg.GREEN), ("z", svg.BLUE))


@dataclass(frozen=True, slots=True, eq=False)
class ArmLayout:
    """Frames of an arm at its pose above the workspace, without load, in the rover frame RMECH."""

    model: ArmModel
    config: Config
    output_rad: Array
    """Output angles, shape (5,)."""
    X_RF: Mapping[str, Pose]
    """Frames Arm1 to Arm6, and those of the tools, by name."""


def show_arm(request: ArmRequest) -> ArmLayout:
    """Place the frames of an arm; BadRequest if there is none, or its picture cannot be written."""
    check_options(request)
    try:
        model = default_arm() if request.arm is None else load_arm(request.arm)
    except (BadArm, BadParams) as error:
        raise BadRequest(str(error)) from error
    config = configure(model.params)
    output = np.array(model.params.poses.ready_rad)
    frames = forward(config.arm, output[:, None])
    placed = {
        name: Pose(frames.X_RF.R[:, :, k, 0], frames.X_RF.p[:, k, 0]) for k, name in enumerate(LINK_NAMES)
    }
    for tool in model.params.tool_names:
        X = tool_pose(config.arm, frames, tool)
        placed[tool] = Pose(X.R[:, :, 0], X.p[:, 0])
    return ArmLayout(model, config, output, placed)


def layout_document(layout: ArmLayout) -> dict[str, Any]:
    """Collect the layout in metres and radians."""
    links, joints = layout.model.params.links, layout.model.params.joints
    return {
        "name": layout.model.name,
        "title": layout.model.description.title,
        "output_rad": layout.output_rad,
        "links": {
            name: {key: getattr(link.transform, key) for key in TRANSFORM}
            for name, link in zip(LINK_NAMES, links.in_order(), strict=True)
        },
        "joints": {
            joint.name.lower(): {key: getattr(params, key) for key in JOINT_KEYS}
            for joint, params in zip(Joint, joints.in_order(), strict=True)
        },
        "frames": {name: {"position_R_m": X.p, "rotation_R": X.R} for name, X in layout.X_RF.items()},
    }


def layout_parts(layout: ArmLayout) -> list[ReportTable]:
    """Show links, joints and frames of the arm."""
    params = layout.model.params
    links = []
    for number, name in enumerate(LINK_NAMES):
        transform = params.links.in_order()[number].transform
        sizes = (transform.d_m, transform.b_m, degrees(transform.alpha_rad), transform.a_m)
        row = [name, *(f"{size:g}" for size in sizes)]
        if number < len(Joint):
            joint = params.joints.in_order()[number]
            limits = (joint.soft_min_rad, joint.soft_max_rad)
            row += [Joint(number).name.lower(), *(f"{degrees(limit):.1f}" for limit in limits)]
        links.append(row)
    link_head = ("link", "d m", "b m", "alpha deg", "a m", "joint at its end", "from deg", "to deg")
    angles = ", ".join(f"{degrees(angle):.0f}" for angle in layout.output_rad)
    frames = [(name, *(f"{value:+.3f}" for value in X.p)) for name, X in layout.X_RF.items()]
    return [
        ReportTable(link_head, links, f"{layout.model.description.title}: links (equation 1)"),
        ReportTable(("frame", "x m", "y m", "z m"), frames, f"Frames in RMECH at {angles} deg, without load"),
    ]


def save_layout_picture(layout: ArmLayout, path: Path) -> None:
    """Save arm, rover and frames as PNG; BadOutput if that fails."""

    def draw(figure: Any) -> None:
        figure.suptitle(
            f"{layout.model.description.title}: frames of the arm at its pose above the workspace"
        )
        side, above, turret = figure.subplots(1, 3, width_ratios=(1.25, 1.25, 1.0))
        _draw_arm(side, layout, 2)
        side.set(title="Arm1 to Arm6 from the side, RMECH", xlabel="x forward [m]", ylabel="z down [m]")
        side.invert_yaxis()
        _draw_arm(above, layout, 1)
        above.set(title="From above, RMECH", xlabel="x forward [m]", ylabel="y right [m]")
        above.invert_yaxis()
        _draw_turret(turret, layout)
        side.legend(loc="upper right")

    svg.save_png(path, (14.0, 5.2), draw)


def _draw_arm(axes: Any, layout: ArmLayout, vertical: int) -> None:
    """Draw the arm before the rover; the vertical axis of the picture is y (1) or z (2) of the rover."""
    plane, config = (0, vertical), layout.config
    shapes, frames = config.collision_geometry, forward(config.arm, layout.output_rad[:, None])
    rover = project_outlines(shapes.rover, shapes.rover.X_CS, plane)
    draw_outlines(axes, rover, facecolor=svg.SHADE, edgecolor=svg.MUTED)
    arm = project_outlines(shapes.arm, place_shapes(shapes, frames)[:, 0], plane)
    draw_outlines(axes, arm, facecolor=svg.LIGHT, edgecolor=svg.MUTED, alpha=0.35)
    origins = np.array([layout.X_RF[link].p for link in LINK_NAMES])[:, plane]
    for link, p, away in zip(LINK_NAMES, origins, directions_away(origins), strict=True):
        _draw_triad(axes, Pose(layout.X_RF[link].R[list(plane)], p))
        axes.annotate(
            link.title(),
            p,
            # both views have their vertical axis downward
            xytext=NAME_DISTANCE_PT * away * (1, -1),
            textcoords="offset points",
            fontsize=9,
            ha="center",
            va="center",
            bbox=BEHIND_NAME,
        )
    p = np.array([X.p for X in layout.X_RF.values()])[:, plane]
    low, high = p.min(axis=0) - MARGIN_M, p.max(axis=0) + MARGIN_M
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    for axis, colour in AXES:
        axes.plot([], [], color=colour, linewidth=2.0, label=f"{axis} axis")


def directions_away(origins_m: Array) -> Array:
    """Compute the unit direction (n, 2) of each origin (n, 2) away from the others, mostly the nearest.

    So the name of a frame is nearer to its own origin than to that of another.
    """
    # a millimetre more each parts origins that coincide in the picture
    parted = origins_m + np.arange(len(origins_m))[:, None] * (1e-3, 0.0)
    between = parted[:, None] - parted
    square = np.sum(between**2, axis=-1, keepdims=True)
    away = np.sum(np.divide(between, square**2, out=np.zeros_like(between), where=square > 0), axis=1)
    directions: Array = away / np.linalg.norm(away, axis=1, keepdims=True)
    return directions


NAME_DISTANCE_PT: Final = 26.0
"""Distance of a name from the origin of its frame; a name is about as wide."""
BEHIND_NAME: Final = {"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 1.0}
"""Box that parts a name from the lines behind it."""


def _draw_turret(axes: Any, layout: ArmLayout) -> None:
    """Draw the frames of the tools on the turret, seen along its axis; x is the approach of a tool."""
    turret = layout.X_RF[LINK_NAMES[-1]]
    axes.plot(0.0, 0.0, "o", color=svg.INK)
    axes.annotate("Arm6", (0.0, 0.0), xytext=(6, 6), textcoords="offset points")
    for tool in layout.model.params.tool_names:
        X = layout.X_RF[tool]
        R, p = turret.R.T @ X.R, turret.R.T @ (X.p - turret.p)
        axes.plot((0.0, p[0]), (0.0, p[1]), color=svg.FAINT)
        _draw_triad(axes, Pose(R[:2], p[:2]))
        axes.text(*(0.75 * p[:2]), tool, ha="center", va="center", bbox=BEHIND_NAME)
    axes.set(title="Tools, in Arm6, along its z axis", xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.margins(0.25)


def _draw_triad(axes: Any, X: Pose) -> None:
    """Draw the axes of a frame; R (2, 3) and p (2,) are in the plane of the picture."""
    for k, (_, colour) in enumerate(AXES):
        axes.plot(*np.array([X.p, X.p + TRIAD_M * X.R[:, k]]).T, color=colour, linewidth=2.0)
