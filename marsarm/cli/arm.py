"""Define the verbs `arm list`, `arm show` and `arm build`."""

import typer

from marsarm.arms.request import ArmBuildRequest, ArmShowRequest
from simgap.common.verb import VerbResult, verb

arm_app = typer.Typer(
    help="List and show arms, and build the files of an arm from its arm.toml.", no_args_is_help=True
)


@arm_app.command("list")
@verb
def list_arms() -> VerbResult:
    """List the arms of the project: names for --arm, lengths, mass and tools.

    Example: marsarm arm list
    """
    from marsarm.arms.build import arms_table, describe_arm
    from sim.arm_model.load import arm_names, load_arm

    models = [load_arm(name) for name in arm_names()]
    return VerbResult({"arms": [describe_arm(model) for model in models]}, lambda: arms_table(models))


@arm_app.command("show")
@verb
def show(request: ArmShowRequest) -> VerbResult:
    """Show the links, joints and frames of an arm at its pose above the workspace.

    Example: marsarm arm show m2020 --picture m2020-layout.png
    """
    from marsarm.arms.layout import layout_json, layout_table, save_layout_picture, show_arm

    layout, picture = show_arm(request), request.picture
    problem = None if picture is None else save_layout_picture(layout, picture)
    return VerbResult(
        {**layout_json(layout), "picture_problem": problem},
        lambda: layout_table(layout, picture, problem),
    )


@arm_app.command("build")
@verb
def build(request: ArmBuildRequest) -> VerbResult:
    """Make arm.xml, the MJCF of the plant, and flight.toml, the flight parameters, from arm.toml.

    An arm that cannot be homed, stowed or brought to its workspace is refused. The files are for people and
    other tools; marsarm itself reads arm.toml alone, so they are never needed to run.

    Example: marsarm arm build my-arm
    """
    from marsarm.arms.build import build_arms, describe_arm, files_table

    found = build_arms(request)
    arms = [{**describe_arm(one.model), "files": [str(path) for path in one.texts]} for one in found]
    return VerbResult({"arms": arms}, lambda: files_table(found))
