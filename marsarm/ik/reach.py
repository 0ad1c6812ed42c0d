"""Reach map of the workspace of an arm: sampling, counts of valid branches, and plot."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from fsw.collision.geometry import build_collision_geometry
from fsw.kinematics.ik import BranchVerdict
from fsw.kinematics.transforms import Array
from marsarm.common.pool import Runner, select_runner
from marsarm.ik.request import ReachRequest
from marsarm.ik.solve import (
    IkModel,
    IkTargets,
    Tally,
    build_ik_model,
    model_document,
    tally_document,
    tally_table,
)
from marsarm.render.rover_scene import draw_outlines, project_outlines
from marsarm.render.svg import save_figure
from sim.frames import P_NR_M, approach_from, p_R_from_N, random_targets
from simgap.common.options import check_options
from simgap.common.progress import Progress, no_progress
from simgap.common.report import ReportTable, file_lines

SAMPLES_PER_CELL: Final = 40
CELLS: Final = (4, 30)
"""Smallest and largest number of cells along each side of a map."""
MIN_SAMPLES: Final = 5
"""Smallest number of samples in a cell; cells with fewer samples are grey."""
ROVER_SEEN_M: Final = 1.5
"""Length in front of the workspace that the picture shows of the rover."""
GREY: Final = "0.85"


@dataclass(frozen=True, slots=True, eq=False)
class ReachSamples:
    """Targets in the workspace with their numbers of valid branches."""

    p_NoTo_N_m: Array
    """Positions in RNAV, shape (3, n)."""
    angles_rad: Array
    """Approach angles below horizontal and to the right of straight ahead, shape (2, n)."""
    valid: NDArray[np.int64]
    """Number of valid branches, shape (n,)."""


def sample_workspace(
    model: IkModel, count: int, seed: int, run: Runner, progress: Progress
) -> tuple[ReachSamples, Tally]:
    """Draw random targets of the workspace and solve their inverse kinematics."""
    p_N_m, angles = random_targets(np.random.default_rng(seed), count, model.workspace)
    targets = IkTargets(p_R_from_N(p_N_m.T).T, approach_from(angles))
    valid, counted = [], Tally()
    for result in model.solve_in_batches(targets, run, progress):
        valid.append((result.verdict == BranchVerdict.VALID).sum(axis=0))
        counted.add(result)
    return ReachSamples(p_N_m, angles, np.concatenate(valid)), counted


def save_reach_figure(samples: ReachSamples, counted: Tally, model: IkModel, path: Path) -> None:
    """Save the plot as PNG; BadOutput if that fails."""

    def draw(figure: Any) -> None:
        figure.get_layout_engine().set(w_pad=0.1, h_pad=0.1)
        figure.suptitle(_title(samples, counted, model), fontsize=11)
        _draw_maps(figure, samples, model)

    save_figure(path, (14, 5.5), draw)


def _draw_maps(figure: Any, samples: ReachSamples, model: IkModel) -> None:
    from matplotlib.patches import Circle, Rectangle, Wedge
    from matplotlib.ticker import MultipleLocator

    space = model.workspace
    x_m, y_m, radius_m = space.centre_x_m, space.centre_y_m, space.radius_m
    x_range, y_range = (x_m - radius_m, x_m + radius_m), (y_m - radius_m, y_m + radius_m)
    z_range = (space.top_z_m, space.bottom_z_m)
    side, top, wedge = figure.subplots(1, 3, width_ratios=(1.35, 1.0, 0.9))
    x, y, z = samples.p_NoTo_N_m
    down_deg, right_deg = np.degrees(samples.angles_rad)
    scale_max = max(float(np.quantile(samples.valid, 0.99)), 1.0)

    def mapped(axes: Any, across: Array, along: Array, ranges: Any) -> Any:
        return _draw_map(axes, (across, along, samples.valid), ranges, scale_max)

    rover = build_collision_geometry(model.params, model.arm).rover
    for axes, plane in ((side, (0, 2)), (top, (1, 0))):
        outlines = project_outlines(rover, rover.X_CS, plane)
        draw_outlines(axes, outlines, P_NR_M[list(plane)], facecolor="0.93", edgecolor="0.6")
    down, right = np.degrees((space.wedge_down_rad, space.wedge_side_rad))
    outline: dict[str, Any] = {"fill": False, "edgecolor": "black", "linewidth": 1.2}
    approach: dict[str, Any] = {"facecolor": "white", "alpha": 0.45, "edgecolor": "black"}
    size = (2.0 * radius_m, z_range[1] - z_range[0])
    side.add_patch(Rectangle((x_range[0], z_range[0]), *size, color=GREY))
    mapped(side, x, z, (x_range, z_range))
    side.add_patch(Rectangle((x_range[0], z_range[0]), *size, **outline))
    side.add_patch(Wedge((x_m, sum(z_range) / 2), 0.6 * radius_m, 0.0, down, **approach))
    side.axhline(0.0, color="black", linewidth=1.0, linestyle="--")
    around = (x_range[0] - ROVER_SEEN_M, x_range[1] + 0.25 * radius_m)
    side.text(around[0] + 0.03, 0.0, "ground", va="bottom")
    side.set(title="Side: mean over y, approach", xlabel="x forward [m]", ylabel="z down [m]", xlim=around)
    side.set_ylim(max(z_range[1], 0.0) + 0.1, min(z_range[0], -1.5) - 0.1)
    top.add_patch(Circle((y_m, x_m), radius_m, color=GREY))
    mapped(top, y, x, (y_range, x_range))
    top.add_patch(Circle((y_m, x_m), radius_m, **outline))
    top.add_patch(Wedge((y_m, x_m), 0.6 * radius_m, 90.0 - right, 90.0 + right, **approach))
    top.set(title="Top: mean over z, approach", xlabel="y right [m]", ylabel="x forward [m]", ylim=around)
    top.set_xlim(y_m - 2.4 * radius_m, y_m + 2.4 * radius_m)
    for axes in (side, top):
        axes.set_aspect("equal")
    colours = mapped(wedge, right_deg, down_deg, ((-right, right), (0.0, down)))
    wedge.set_facecolor(GREY)
    wedge.set(
        title="Approach: mean over workspace",
        xlabel="to the right of straight ahead [deg]",
        ylabel="below horizontal [deg]",
    )
    wedge.invert_yaxis()
    for axis, widest in ((wedge.xaxis, 2.0 * right), (wedge.yaxis, down)):
        axis.set_major_locator(MultipleLocator(15.0 if widest <= 90.0 else 60.0))
    figure.colorbar(colours, ax=[side, top, wedge], label="valid branches, mean", extend="max", pad=0.02)


def _draw_map(axes: Any, points: tuple[Array, Array, Any], ranges: Any, scale_max: float) -> Any:
    """Draw the mean number of valid branches in each cell; cells with too few samples are grey."""
    across, along, valid = points
    cells = int(np.clip(np.sqrt(len(valid) / SAMPLES_PER_CELL), *CELLS))
    sums, edges_across, edges_along = np.histogram2d(across, along, cells, ranges, weights=valid)
    counts, _, _ = np.histogram2d(across, along, cells, ranges)
    mean = np.ma.masked_where(counts < MIN_SAMPLES, sums / np.maximum(counts, 1))
    return axes.pcolormesh(edges_across, edges_along, mean.T, vmin=0.0, vmax=scale_max, cmap="viridis")


def _title(samples: ReachSamples, counted: Tally, model: IkModel) -> str:
    reachable_percent = 100.0 * (1.0 - counted.targets_by_valid[0] / counted.targets)
    return (
        f"Reach in the workspace, RNAV: {model.description}\n"
        f"{counted.targets} random targets, {reachable_percent:.2f} % with a valid branch; "
        f"limits only, no collisions; sector: approaches; grey: rover, or fewer than {MIN_SAMPLES} targets"
    )


@dataclass(frozen=True, slots=True, eq=False)
class ReachReport:
    """Result of a request for a reach map."""

    request: ReachRequest
    model: IkModel
    tally: Tally


def reach(request: ReachRequest, progress: Progress = no_progress) -> ReachReport:
    """Sample the workspace, and draw the map if requested; BadRequest if the request is wrong."""
    check_options(request)
    model = build_ik_model(request.model)
    run = select_runner(request.workers, request.cluster)
    samples, counted = sample_workspace(model, request.samples, request.seed, run, progress)
    if request.picture is not None:
        progress(1, 1, "drawing")
        save_reach_figure(samples, counted, model, request.picture)
    return ReachReport(request, model, counted)


def reach_document(report: ReachReport) -> dict[str, Any]:
    """Collect a reach map: counts, the model and the picture."""
    request = report.request
    return {
        **tally_document(report.tally),
        **model_document(report.model),
        "seed": request.seed,
        "picture": request.picture,
    }


def reach_parts(report: ReachReport) -> list[str | ReportTable]:
    """Show a reach map: counts, and the path of the picture."""
    title = f"{report.model.description}: {report.tally.targets} random targets of the workspace"
    return [tally_table(title, report.tally), *file_lines({"picture": report.request.picture})]
