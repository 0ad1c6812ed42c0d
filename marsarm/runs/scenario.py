"""Execution of a scenario: check the request, run it, apply its checks, report."""

from dataclasses import asdict, dataclass, replace

from fsw.config import CYCLE_HZ
from marsarm.common.requests import make_world, parse_effects, select_arm
from marsarm.runs.execution import (
    INITIALISATION_SHARE,
    Execution,
    execute,
    execution_not_begun,
    initialise,
)
from marsarm.runs.request import RunRequest
from marsarm.telemetry.recorder import run_header
from sim.arms import BuiltArm
from sim.effects.effect import EffectMisfit
from sim.effects.environment import default_ambient
from sim.loop import ClosedLoop
from sim.scenario.data import Scenario
from sim.scenario.file import BadScenario, load_scenario
from sim.scenario.rehearsal import find_impossible
from sim.scenario.run import NotTaught, ScenarioResult, ScenarioRun, scenario_setup, teach
from sim.sequence import Outcome
from simgap.common.errors import BadRequest
from simgap.common.files import check_unlocked
from simgap.common.options import check_options
from simgap.common.progress import GUESS, Progress, as_guess, no_progress


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


def run_scenario(request: RunRequest, progress: Progress = no_progress) -> RunReport:
    """Carry out a scenario; BadRequest, before anything moves or is written, if it is wrong."""
    scenario, arm = _prepare(request)
    check_unlocked(request.files.log, "log")
    # flight software takes the friction of this day from the initialisation
    ambient = default_ambient(arm.effects, scenario.temperature_C)
    on_this_day = replace(arm, effects=(*ambient, *arm.effects))
    last = initialise(on_this_day, request.seed, as_guess(progress))
    if last.outcome is not Outcome.DONE:
        result = ScenarioResult(last.outcome, 0, last.duration_s, (), last.evrs)
        return RunReport(request, scenario, arm.name, execution_not_begun(result, arm, request.files))
    progress(INITIALISATION_SHARE, GUESS, "teaching")
    try:
        arm = teach(arm, last.reference, scenario.taught, scenario.world, request.seed)
    except NotTaught as error:
        raise BadRequest(f"scenario {scenario.name}: {error}") from error
    setup = scenario_setup(scenario, arm, last.reference, request.seed)
    loop = ClosedLoop(setup, with_truth=True)
    scenario_run = ScenarioRun(loop, scenario)
    # the picture is taken at the end of the last command with a check
    checked = max(getattr(check, name, 0) for check in scenario.checks for name in ("after", "during"))
    picture_command = checked or len(scenario.commands)
    execution = execute(
        scenario_run,
        loop,
        run_header(
            loop, arm.name, request.seed, asdict(request), scenario.commands, scenario.effects, scenario.world
        ),
        request.files,
        scenario.world,
        progress,
        progress_at=lambda record: (scenario_run.guess_share(record.tick / CYCLE_HZ), GUESS),
        is_for_picture=lambda _: scenario_run.command == picture_command,
        arm=arm.model,
        title=f"{scenario.title} on arm {arm.name}",
    )
    return RunReport(request, scenario, arm.name, execution)


def _prepare(request: RunRequest) -> tuple[Scenario, BuiltArm]:
    """Check a request, before anything moves or is written, and return its scenario and arm."""
    check_options(request)
    if not request.scenario:
        raise BadRequest("scenario: give a name or a file; `marsarm run --list` lists what there is")
    try:
        scenario = load_scenario(request.scenario, request.arm)
    except BadScenario as error:
        raise BadRequest(str(error)) from error
    arm = select_arm(scenario.arm if request.arm is None else request.arm, request.params, request.mismatch)
    if request.tilt_deg is not None:
        tilted = make_world(scenario.world.scene, *request.tilt_deg)
        scenario = scenario.tilted(tilted.tilt_roll_rad, tilted.tilt_pitch_rad)
    added = parse_effects(request.effects, arm.params.tool_names)
    scenario = replace(scenario, effects=(*scenario.effects, *added))
    try:
        arm = scenario.fit_arm(arm)
    except EffectMisfit as error:
        raise BadRequest(f"{request.scenario}: {error}") from error
    problem = find_impossible(scenario, arm)
    if problem is not None:
        raise BadRequest(f"{request.scenario}: {problem}")
    return scenario, arm
