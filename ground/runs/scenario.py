"""Execution of a scenario: check the request, run it, apply its checks, report."""

import time
from dataclasses import asdict, dataclass, replace

from fsw.config import digest
from ground.common.errors import BadRequest
from ground.common.options import check_options
from ground.common.progress import Progress
from ground.common.requests import make_world, parse_effects, select_arm
from ground.runs.execution import (
    Artifacts,
    Frames,
    describe_activity,
    initialise,
    no_artifacts,
    open_log,
    record_cycles,
    save_artifacts,
)
from ground.runs.request import RunRequest
from ground.telemetry.header import run_header
from sim.arms import BuiltArm
from sim.initialisation import InitialisationResult
from sim.loop import ClosedLoop
from sim.scenario.data import Scenario
from sim.scenario.file import BadScenario, load_scenario
from sim.scenario.run import ScenarioResult, ScenarioRun, scenario_setup
from sim.scenario.teaching import NotTaught, teach
from sim.sequence import Outcome


@dataclass(frozen=True, slots=True)
class RunReport:
    """Frozen record of a run and its artifacts."""

    request: RunRequest
    scenario: Scenario
    """Scenario with the tilt and the effects of the request."""
    arm: str
    params_sha256: str
    result: ScenarioResult
    realtime_factor: float
    """Duration on Mars over wall time."""
    artifacts: Artifacts

    @property
    def passed(self) -> bool:
        """True if the run was completed and passed all checks of its scenario."""
        return self.result.passed


def run(request: RunRequest, progress: Progress) -> RunReport:
    """Carry out a scenario.

    Raises:
        BadRequest: the request or the scenario is wrong; nothing moved and nothing was written.
    """
    scenario, arm = _prepare(request)
    stops = initialise(arm, request.seed, progress)
    if stops[-1].outcome is not Outcome.DONE:
        return _not_initialised(request, scenario, arm, stops)
    reference = stops[-1].reference
    progress(0, 1, "teaching")
    try:
        arm = teach(arm, reference, scenario.taught, scenario.world, request.seed)
    except NotTaught as error:
        raise BadRequest(f"scenario {scenario.name}: {error}") from error
    setup = scenario_setup(scenario, arm, reference, request.seed)
    loop = ClosedLoop(setup, with_truth=request.files.log is not None)
    scenario_run = ScenarioRun(loop, scenario)
    header = run_header(loop, arm.name, request.seed, asdict(request), scenario.commands, scenario.effects)
    log = open_log(request.files.log, header, loop.config)
    frames, picture_command, total = Frames(), _picture_command(scenario), len(scenario.commands)
    started = time.perf_counter()
    try:
        for record in record_cycles(scenario_run, log, request.files.when_disk_full):
            if frames.note(loop.plant, record):
                progress(scenario_run.command - 1, total, describe_activity(record))
            if scenario_run.command == picture_command:
                frames.choose(loop.plant)
    finally:
        log.close()
    wall_s = time.perf_counter() - started
    if loop.failure is not None:
        raise loop.failure
    result = scenario_run.result()
    return RunReport(
        request=request,
        scenario=scenario,
        arm=arm.name,
        params_sha256=loop.config.params_sha256,
        result=result,
        realtime_factor=result.duration_s / wall_s,
        artifacts=save_artifacts(request.files, scenario.world, frames, loop.plant.data.qpos, log, progress),
    )


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


def _not_initialised(
    request: RunRequest, scenario: Scenario, arm: BuiltArm, stops: list[InitialisationResult]
) -> RunReport:
    failed = stops[-1]
    result = ScenarioResult(failed.outcome, 0, failed.duration_s, (), failed.evrs)
    artifacts = no_artifacts(request.files)
    return RunReport(request, scenario, arm.name, digest(arm.params), result, 0.0, artifacts)
