"""Define the verb `place`."""

from pathlib import Path
from typing import Annotated

import typer

from ground.cli.options import (
    EXIT_ARM_SAFE,
    EXIT_BAD_INPUT,
    ArmOption,
    DiskOption,
    EffectOption,
    JsonOption,
    ParamsOption,
    PitchOption,
    RollOption,
    SeedOption,
    Vector,
    fail,
    print_result,
)

ToolOption = Annotated[str, typer.Option(help="apxs, mahli, drt or drill.", metavar="TOOL")]
TargetOption = Annotated[Vector, typer.Option(help="Point on the surface, RNAV, in metres.", metavar="X Y Z")]
NormalOption = Annotated[Vector, typer.Option(help="Direction out of the surface, RNAV.", metavar="NX NY NZ")]
SurfaceOption = Annotated[
    bool,
    typer.Option("--surface/--no-surface", help="Place a rock with this surface in the world, or none."),
]
LogOption = Annotated[Path | None, typer.Option(help="Write a telemetry log (MCAP).", metavar="FILE.mcap")]
PictureOption = Annotated[Path, typer.Option(help="Draw the arm in contact.", metavar="FILE.png")]
MovieOption = Annotated[Path | None, typer.Option(help="Draw the whole run.", metavar="FILE.gif")]


def place(
    tool: ToolOption = "apxs",
    target: TargetOption = (2.05, 0.1, -0.25),
    normal: NormalOption = (-0.5, 0.1, -0.85),
    tilt_roll: RollOption = 0.0,
    tilt_pitch: PitchOption = 0.0,
    arm: ArmOption = "nominal",
    seed: SeedOption = 0,
    params: ParamsOption = None,
    effect: EffectOption = None,
    surface: SurfaceOption = True,
    log: LogOption = None,
    when_disk_full: DiskOption = "go-on",
    picture: PictureOption = Path("place.png"),
    no_picture: Annotated[bool, typer.Option("--no-picture", help="Draw no picture.")] = False,
    movie: MovieOption = None,
    as_json: JsonOption = False,
) -> None:
    """Unstow, place an instrument on a rock, and retract.

    RNAV is x forward, y right, z down, from the ground below the rover: a rock 0.25 m high has z = -0.25.

    Example: marsarm place --tool mahli --target 2.1 0 -0.2 --normal -0.4 0 -1 --tilt-pitch 10
    """
    from ground.common.errors import BadRequest
    from ground.common.progress import progress_bar
    from ground.runs.execution import RunFiles
    from ground.runs.place import PlaceRequest
    from ground.runs.place import place as carry_out
    from ground.runs.tables import place_json, place_table

    request = PlaceRequest(
        tool=tool,
        target_m=target,
        normal=normal,
        tilt_roll_deg=tilt_roll,
        tilt_pitch_deg=tilt_pitch,
        arm=arm,
        seed=seed,
        params=params,
        effects=tuple(effect or ()),
        has_surface=surface,
        files=RunFiles(log, None if no_picture else picture, movie, when_disk_full),
    )
    try:
        with progress_bar() as progress:
            report = carry_out(request, progress)
    except BadRequest as error:
        fail(str(error), EXIT_BAD_INPUT, as_json)
    print_result(place_json(report), as_json, lambda: place_table(report))
    if report.result.outcome != "done":
        raise typer.Exit(EXIT_ARM_SAFE)
