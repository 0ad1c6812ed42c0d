"""Execution of a scenario: check the request, run it, apply its checks, report."""

from dataclasses import asdict, dataclass, replace

from ground.common.errors import BadRequest
from ground.common.options import check_options
from ground.common.progress import Progress
from ground.common.requests import make_world, parse_effects, select_arm
from ground.runs.execution import Execution, execute, execution_not_begun, initialise
from ground.runs.request import RunRequest
from ground.telemetry.header import run_header
from sim.arms import BuiltArm
from sim.loop import ClosedLoop
from sim.scenario.data import Scenario
from sim.scenario.file import BadScenario, load_scenario
from sim.scenario.run import ScenarioResult, ScenarioRun, scenario_setup
from sim.scenario.teaching import NotTaught, teach
from sim.sequence import Outcome


@dataclass(frozen=True, slots=True)
class RunReport:
    """Run of a scenario."""

    request: RunRequest
    scenario: Scenario
    """Scenario with the tilt and the effects of the request."""
    arm: str
    execution: Execution[ScenarioResult]

    @property
    def passed(self) -> bool:
        """True if the run was completed and passed all checks of its scenario."""
        return self.execution.result.passed


def run(request: RunRequest, progress: Progress) -> RunReport:
    """Carry out a scenario.

    Raises:
        BadRequest: the request or the scenario is wrong; nothing moved and nothing was written.
    """
    scenario, arm = _prepare(request)
    last = initialise(arm, request.seed, progress)[-1]
    if last.outcome is not Outcome.DONE:
        result = ScenarioResult(last.outcome, 0, last.duration_s, (), last.evrs)
        return RunReport(request, scenario, arm.name, execution_not_begun(result, arm, request.files))
    progress(0, 1, "teaching")
    try:
        arm = teach(arm, last.reference, scenario.taught, scenario.world, request.seed)
    except NotTaught as error:
        raise BadRequest(f"scenario {scenario.name}: {error}") from error
    setup = scenario_setup(scenario, arm, last.reference, request.seed)
    loop = ClosedLoop(setup, with_truth=request.files.log is not None)
    scenario_run = ScenarioRun(loop, scenario)
    picture_command, total = _picture_command(scenario), len(scenario.commands)
    execution = execute(
        scenario_run,
        loop,
        run_header(loop, arm.name, request.seed, asdict(request), scenario.commands, scenario.effects),
        request.files,
        scenario.world,
        progress,
        progress_at=lambda _: (scenario_run.command - 1, total),
        is_for_picture=lambda _: scenario_run.command == picture_command,
        arm=arm.model,
    )
    return RunReport(request, scenario, arm.name, execution)


def _prepare(request: RunRequest) -> tuple[Scenario, BuiltArm]:
    """Check a request, before anything moves or is written, and return its scenario and arm."""
    check_options(request)
    try:
        scenario = load_scenario(request.scenario)
    except BadScenario as error:
        raise BadRequest(str(error)) from error
    arm = select_arm(scenario.arm if request.arm is None else request.arm, None)
    if request.tilt_deg is not None:
        tilted = make_world(scenario.world.scene, *request.tilt_deg)
        scenario = scenario.tilted(tilted.tilt_roll_rad, tilted.tilt_pitch_rad)
    scenario = replace(scenario, effects=(*scenario.effects, *parse_effects(request.effects)))
    return scenario, scenario.fit_arm(arm)


def _picture_command(scenario: Scenario) -> int:
    """Return the number of the command at whose end the picture is taken: the last one with a check."""
    numbers = [getattr(check, name, 0) for check in scenario.checks for name in ("after", "during")]
    return max(numbers) or len(scenario.commands)
