"""Define the verbs `run` and `scenarios`."""

from ground.cli.verb import VerbResult, verb
from ground.common.progress import Progress
from ground.runs.request import RunRequest


@verb
def run(request: RunRequest, progress: Progress) -> VerbResult:
    """Run a scenario in the closed loop, and check it against the true motion of the arm.

    Example: marsarm run tool-change --arm calibrated:7 --tilt 10 -5 --movie sol46.gif
    """
    from ground.runs.scenario import run
    from ground.runs.tables import run_json, run_table

    report = run(request, progress)
    return VerbResult(run_json(report), lambda: run_table(report), report.passed)


@verb
def scenarios() -> VerbResult:
    """List the built-in scenarios.

    Example: marsarm scenarios --json
    """
    from ground.runs.tables import scenarios_json, scenarios_table
    from sim.scenario.file import built_in_scenarios, load_scenario

    loaded = tuple(load_scenario(name) for name in built_in_scenarios())
    return VerbResult({"scenarios": scenarios_json(loaded)}, lambda: scenarios_table(loaded))
