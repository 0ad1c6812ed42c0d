"""Define the verb `hardstop`."""

from pathlib import Path
from typing import Annotated

import typer

from ground.cli.options import (
    EXIT_ARM_SAFE,
    EXIT_BAD_INPUT,
    ArmOption,
    EffectOption,
    JsonOption,
    ParamsOption,
    PitchOption,
    RollOption,
    SeedOption,
    fail,
    print_result,
)

JointAngles = tuple[float, float, float, float, float]
JointOption = Annotated[
    str | None,
    typer.Option(help="azimuth, elevation, elbow, wrist or turret; all if not given.", metavar="NAME"),
]
AllOption = Annotated[
    bool, typer.Option("--all", help="All joints, one after the other, as flight software does it.")
]
RepeatOption = Annotated[
    int,
    typer.Option(
        help="Number of repetitions. Each begins near the hardstop, with its own temperature (-55 to "
        "10 degC), friction, noise and pose.",
        metavar="N",
    ),
]
SceneOption = Annotated[str, typer.Option(help="mars or earth.", metavar="mars|earth")]
TurretOption = Annotated[
    bool,
    typer.Option(
        "--turret/--no-turret",
        help="Without its turret the arm is calibrated on Earth, in poses with the joint torques of Mars.",
    ),
]
StartOption = Annotated[
    JointAngles | None,
    typer.Option(
        help="Start pose for one joint, degrees; if not given, its planned pose near its hardstop.",
        metavar="J1 J2 J3 J4 J5",
    ),
]
TemperatureOption = Annotated[
    float | None,
    typer.Option(
        help="Temperature of the actuators, degC; 20 if not given. Friction rises in the cold.",
        metavar="DEGC",
    ),
]
PictureOption = Annotated[
    Path | None, typer.Option(help="Draw current, speed and angle.", metavar="FILE.png")
]
PlanOption = Annotated[
    bool, typer.Option("--plan", help="Move nothing; show the poses and the torques that they equalise.")
]


def hardstop(
    joint: JointOption = None,
    every: AllOption = False,
    repeat: RepeatOption = 1,
    arm: ArmOption = "nominal",
    scene: SceneOption = "mars",
    turret: TurretOption = True,
    start: StartOption = None,
    tilt_roll: RollOption = 0.0,
    tilt_pitch: PitchOption = 0.0,
    temperature: TemperatureOption = None,
    seed: SeedOption = 0,
    params: ParamsOption = None,
    effect: EffectOption = None,
    picture: PictureOption = None,
    plan: PlanOption = False,
    as_json: JsonOption = False,
) -> None:
    """Run joints against their negative hardstops and set the encoder zeros there.

    Flight software begins without any zero. Errors are relative to the true hardstop of the arm.

    Example: marsarm hardstop --joint elbow --arm as-built:7 --temperature -40 --picture elbow.png
    """
    from ground.common.errors import BadRequest
    from ground.common.progress import progress_bar
    from ground.runs.hardstop import HardstopRequest, plan_stops
    from ground.runs.hardstop import hardstop as carry_out
    from ground.runs.hardstop_tables import hardstop_json, hardstop_table, plan_json, plan_table

    if every and joint is not None:
        fail(
            f"all: --joint {joint} asks for one joint, --all for all; give one of the two",
            EXIT_BAD_INPUT,
            as_json,
        )
    request = HardstopRequest(
        joint=joint,
        repeat=repeat,
        arm=arm,
        scene=scene,
        turret=turret,
        start_deg=start,
        tilt_roll_deg=tilt_roll,
        tilt_pitch_deg=tilt_pitch,
        temperature_C=temperature,
        seed=seed,
        params=params,
        effects=tuple(effect or ()),
        picture=picture,
    )
    try:
        if plan:
            plans = plan_stops(request)
            print_result(plan_json(plans), as_json, lambda: plan_table(plans))
            return
        with progress_bar() as progress:
            report = carry_out(request, progress)
    except BadRequest as error:
        fail(str(error), EXIT_BAD_INPUT, as_json)
    print_result(hardstop_json(report), as_json, lambda: hardstop_table(report))
    if report.outcome != "done":
        raise typer.Exit(EXIT_ARM_SAFE)
