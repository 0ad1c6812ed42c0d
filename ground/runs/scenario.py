"""The scenario job: check the request, run it, judge it, keep the evidence."""

import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from fsw.config import digest
from ground.common.progress import Progress
from ground.common.requests import BadRequest, check_seed, make_world, parse_effects, select_arm
from ground.runs.execution import (
    NO_FILES,
    Artifacts,
    Frames,
    RunFiles,
    check_run_files,
    describe_activity,
    initialise,
    no_artifacts,
    open_log,
    record_cycles,
    save_artifacts,
)
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
class RunRequest:
    """What is asked; degrees; what is None is as the scenario says."""

    scenario: str
    """The name of one that comes with the house, or the path of a TOML file."""
    arm: str | None = None
    tilt_deg: tuple[float, float] | None = None
    """Roll and pitch."""
    seed: int = 0
    files: RunFiles = NO_FILES
    effects: tuple[str, ...] = ()
    """Besides those of the scenario, as the command line writes them."""


@dataclass(frozen=True, slots=True)
class RunReport:
    """What came of it."""

    request: RunRequest
    scenario: Scenario
    """With the tilt and the effects of the request."""
    arm: str
    params_sha256: str
    result: ScenarioResult
    realtime_factor: float
    artifacts: Artifacts

    @property
    def passed(self) -> bool:
        """Whether the run did all that its scenario calls success."""
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
    judged = ScenarioRun(loop, scenario)
    header = run_header(loop, arm.name, request.seed, asdict(request), scenario.commands, scenario.effects)
    log = open_log(request.files.log, header, loop.config)
    frames, shown, total = Frames(), _picture_command(scenario), len(scenario.commands)
    started = time.perf_counter()
    try:
        for record in record_cycles(judged, log, request.files.when_disk_full):
            if frames.note(loop.plant, record):
                progress(judged.command - 1, total, describe_activity(record))
            if judged.command == shown:
                frames.choose(loop.plant)
    finally:
        log.close()
    wall_s = time.perf_counter() - started
    if loop.failure is not None:
        raise loop.failure
    result = judged.result()
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
    """The scenario on its arm, after every check that can be made before anything moves or is written."""
    check_seed(request.seed)
    try:
        scenario = load_scenario(request.scenario)
    except BadScenario as error:
        raise BadRequest(str(error)) from error
    arm = select_arm(scenario.arm if request.arm is None else request.arm, None)
    if request.tilt_deg is not None:
        tilted = make_world(scenario.world.scene, *request.tilt_deg)
        scenario = scenario.tilted(tilted.tilt_roll_rad, tilted.tilt_pitch_rad)
    scenario = replace(scenario, effects=(*scenario.effects, *parse_effects(request.effects)))
    read = Path(request.scenario)
    check_run_files(request.files, scenario=read if read.suffix == ".toml" else None)
    return scenario, scenario.fit_arm(arm)


def _picture_command(scenario: Scenario) -> int:
    """The command at whose end the picture is taken: the last one that a check looks at."""
    numbers = [getattr(check, name, 0) for check in scenario.checks for name in ("after", "during")]
    return max(numbers) or len(scenario.commands)


def _not_initialised(
    request: RunRequest, scenario: Scenario, arm: BuiltArm, stops: list[InitialisationResult]
) -> RunReport:
    failed = stops[-1]
    result = ScenarioResult(failed.outcome, 0, failed.duration_s, (), failed.evrs)
    artifacts = no_artifacts(request.files)
    return RunReport(request, scenario, arm.name, digest(arm.params), result, 0.0, artifacts)
