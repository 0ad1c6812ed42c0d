"""Define the verbs of the inverse kinematics: `ik` and `reach`."""

from pathlib import Path
from typing import Annotated

import typer

from ground.cli.options import (
    EXIT_BAD_INPUT,
    JsonOption,
    ParamsOption,
    PitchOption,
    RollOption,
    Vector,
    fail,
    print_result,
)

ToolOption = Annotated[str, typer.Option(help="drill, drt, mahli, apxs or portion.", metavar="TOOL")]
CompensateOption = Annotated[
    str,
    typer.Option(
        help="absolute: the tool of the arm deflected by gravity meets the target; off: that of the rigid "
        "arm, and gravity and tilt do not matter.",
        metavar="absolute|off",
    ),
]
GravityOption = Annotated[str, typer.Option(help="mars or earth.", metavar="mars|earth")]
WarmingOption = Annotated[
    float, typer.Option(help="Temperature of the arm above that at calibration, in kelvin.", metavar="K")
]
BelievedArmOption = Annotated[
    str,
    typer.Option(
        help="nominal, as-built:SEED or calibrated:SEED: the arm that flight software assumes, by its "
        "flight parameters; those of as-built are nominal.",
        metavar="ARM",
    ),
]


def ik(
    tool: ToolOption = "apxs",
    position: Annotated[
        Vector | None, typer.Option(help="Position of the tool's origin, in metres.", metavar="X Y Z")
    ] = None,
    approach: Annotated[
        Vector | None,
        typer.Option(help="Direction of the tool, of any length.", metavar="AX AY AZ"),
    ] = None,
    frame: Annotated[
        str,
        typer.Option(
            help="Frame of position and approach. rnav: from the ground below the rover, as for place; "
            "rmech: parallel to it, from the rover's mechanical frame.",
            metavar="rnav|rmech",
        ),
    ] = "rnav",
    compensate: CompensateOption = "absolute",
    tilt_roll: RollOption = 0.0,
    tilt_pitch: PitchOption = 0.0,
    gravity: GravityOption = "mars",
    warming: WarmingOption = 0.0,
    arm: BelievedArmOption = "nominal",
    params: ParamsOption = None,
    batch: Annotated[
        Path | None,
        typer.Option(
            help="File of targets: .npz with position_m and approach (n, 3), or .parquet with position_x_m, "
            "position_y_m, position_z_m, approach_x, approach_y, approach_z.",
            metavar="FILE",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="File for their solutions, .npz or .parquet; an existing file is replaced.", metavar="FILE"
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Compute the five output angles of every branch of a target, or the reason why it is invalid.

    x forward, y right, z down; collisions are not checked. The exit status is 0 also if no branch reaches the
    target. With compensation, a branch far outside the limits has no angles, only its approximate excess.

    Example: marsarm ik --tool mahli --position 2.1 0 -0.3 --approach 0.5 0 0.85 --tilt-pitch 10
    """
    from ground.common.errors import BadRequest
    from ground.common.progress import progress_bar
    from ground.ik.model import ModelRequest
    from ground.ik.report import batch_json, batch_table, ik_json, ik_table
    from ground.ik.solve import IkReport, IkRequest, solve

    model = ModelRequest(tool, compensate, tilt_roll, tilt_pitch, gravity, warming, arm, params)
    try:
        with progress_bar() as progress:
            report = solve(IkRequest(model, frame, position, approach, batch, out), progress)
    except BadRequest as error:
        fail(str(error), EXIT_BAD_INPUT, as_json)
    if isinstance(report, IkReport):
        print_result(ik_json(report), as_json, lambda: ik_table(report))
    else:
        print_result(batch_json(report), as_json, lambda: batch_table(report))


def reach(
    tool: ToolOption = "apxs",
    compensate: CompensateOption = "absolute",
    tilt_roll: RollOption = 0.0,
    tilt_pitch: PitchOption = 0.0,
    gravity: GravityOption = "mars",
    warming: WarmingOption = 0.0,
    arm: BelievedArmOption = "nominal",
    params: ParamsOption = None,
    samples: Annotated[int, typer.Option(help="Number of random targets.")] = 20_000,
    seed: Annotated[int, typer.Option(help="Seed of the random targets.")] = 0,
    picture: Annotated[Path, typer.Option(help="Draw the map.", metavar="FILE.png")] = Path("reach.png"),
    no_picture: Annotated[bool, typer.Option("--no-picture", help="Draw no picture.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Count the valid branches in the primary workspace, and the reasons why others are invalid.

    The workspace is a cylinder 0.8 m across and 1.0 m tall around RNAV x = 2.1 m, from 0.2 m below the ground
    up; approaches from horizontal to vertical down, to 45 deg on either side. Collisions are not checked.

    Example: marsarm reach --tool drill --gravity earth --picture drill.png
    """
    from ground.common.errors import BadRequest
    from ground.common.progress import progress_bar
    from ground.ik.model import ModelRequest
    from ground.ik.reach import ReachRequest
    from ground.ik.reach import reach as carry_out
    from ground.ik.report import reach_json, reach_table

    model = ModelRequest(tool, compensate, tilt_roll, tilt_pitch, gravity, warming, arm, params)
    try:
        with progress_bar() as progress:
            report = carry_out(ReachRequest(model, samples, seed, None if no_picture else picture), progress)
    except BadRequest as error:
        fail(str(error), EXIT_BAD_INPUT, as_json)
    print_result(reach_json(report), as_json, lambda: reach_table(report))
