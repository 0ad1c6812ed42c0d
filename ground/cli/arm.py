"""Define the verbs `arm list` and `arm build`."""

import typer

from ground.arms.request import ArmBuildRequest
from ground.cli.verb import VerbResult, verb

arm_app = typer.Typer(
    help="List arms, and build the files of an arm from its arm.toml.", no_args_is_help=True
)


@arm_app.command("list")
@verb
def list_arms() -> VerbResult:
    """List the arms of the project: names for --arm, lengths, mass and tools.

    Example: marsarm arm list
    """
    from ground.arms.build import arms_table, describe_arm
    from sim.arm_model.load import arm_names, load_arm

    models = [load_arm(name) for name in arm_names()]
    return VerbResult({"arms": [describe_arm(model) for model in models]}, lambda: arms_table(models))


@arm_app.command("build")
@verb
def build(request: ArmBuildRequest) -> VerbResult:
    """Make arm.xml, the MJCF of the plant, and flight.toml, the flight parameters, from arm.toml.

    They are for people and other tools. marsarm itself reads arm.toml alone, so they are never needed to run.

    Example: marsarm arm build my-arm
    """
    from ground.arms.build import build_arms, describe_arm, files_table

    found = build_arms(request)
    arms = [{**describe_arm(one.model), "files": [str(path) for path in one.texts]} for one in found]
    return VerbResult({"arms": arms}, lambda: files_table(found))
