"""Replay: today's flight software runs on recorded sensors and commands, and its outputs are compared."""

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import mujoco

from fsw.config import CYCLE_HZ, configure
from fsw.dictionary.params import Params
from fsw.messages import Outputs
from fsw.state import boot, outputs_at_rest
from marsarm.replaying.compare import Differences, compare_behaviours
from marsarm.replaying.inputs import (
    OUTPUT_TOPICS,
    Behaviour,
    Inputs,
    behaviour_from_log,
    behaviour_from_outputs,
    inputs_from_log,
)
from marsarm.telemetry.errors import LogError
from marsarm.telemetry.events import record_to_json
from marsarm.telemetry.header import IMPORT, cpu_features
from marsarm.telemetry.read import Log, read_log
from marsarm.telemetry.topics import channel_matches, channel_name
from sim.loop import step_flight_software
from sim.params import params_over
from sim.params_table import BadParams
from sim.scenario.records import did_you_mean
from simgap.common.errors import BadRequest
from simgap.common.progress import Progress, no_progress

OTHER_PROCESSOR_TOLERANCE: Final = 1e-12
"""Tolerance for another processor, whose kernels may round sums in another order."""


@dataclass(frozen=True, slots=True)
class ReplayRequest:
    """Request of a replay."""

    log: Path
    channel: str = "*"
    """Pattern of channels to compare, such as `/joint.*`; lengths and events are always compared."""
    params: Path | None = None
    """File with parameters that replace those of the log; None for none."""


@dataclass(frozen=True, slots=True, eq=False)
class ReplayReport:
    """Result of a replay."""

    request: ReplayRequest
    header: dict[str, str]
    differences: Differences
    changed_params: tuple[str, ...]
    """Sentences about parameters that differ from the log."""
    notes: tuple[str, ...]
    same_processor: bool


def replay(request: ReplayRequest, progress: Progress = no_progress) -> ReplayReport:
    """Replay a log and compare the outputs.

    Raises:
        BadRequest: the log or the parameters cannot be read or used, or there is nothing to compare.
    """
    try:
        log = read_log(request.log)
        if f'"{IMPORT}"' in log.header.get("request", ""):
            raise BadRequest(
                f"log {log.path}: was imported, so its commands are unknown; give the log of a run"
            )
        inputs = inputs_from_log(log)
        params = inputs.params if request.params is None else params_over(inputs.params, request.params)
    except (LogError, BadParams) as error:
        raise BadRequest(str(error)) from error
    recorded = behaviour_from_log(log, inputs.ticks)
    _check_channel(request.channel, recorded)
    notes, theirs = inputs.notes, log.header.get("mujoco", mujoco.__version__)
    if theirs != mujoco.__version__:
        notes = (
            *notes,
            f"recorded with MuJoCo {theirs}, here is {mujoco.__version__}; a run made anew may differ",
        )
    same = is_same_processor(log)
    differences = compare_behaviours(
        recorded,
        behaviour_from_outputs(run_flight_software(inputs, params, progress)),
        tolerance=0.0 if same else OTHER_PROCESSOR_TOLERANCE,
        chosen=partial(channel_matches, pattern=request.channel),
    )
    if differences.identical and differences.nothing_compared:
        raise BadRequest(
            f"log {request.log}: nothing to compare: flight software ran through its sensors, but the log "
            f"holds no event and no channel of {', '.join(t.name for t in OUTPUT_TOPICS)} to compare with"
        )
    changed = tuple(_changed_values(record_to_json(inputs.params), record_to_json(params), ""))
    return ReplayReport(request, dict(log.header), differences, changed, notes, same)


def run_flight_software(inputs: Inputs, params: Params, progress: Progress) -> list[Outputs]:
    """Run today's flight software on recorded inputs, up to the end or a software error.

    Returns:
        Outputs of each cycle.
    """
    config = configure(params)
    state = boot(config, inputs.mode, inputs.reference)
    last = outputs_at_rest(state)
    outputs: list[Outputs] = []
    for tick in range(inputs.ticks):
        sensors, commands = inputs.sensors_at(tick), inputs.commands.get(tick, ())
        state, last, failure = step_flight_software(config, state, last, sensors, commands)
        outputs.append(last)
        if failure is not None:
            break
        if tick % CYCLE_HZ == 0:
            progress(tick, inputs.ticks, "replaying")
    return outputs


def is_same_processor(log: Log) -> bool:
    """Return whether a log was made on a processor with the same instruction sets and kernels."""
    return log.header.get("cpu") == json.dumps(cpu_features())


def _check_channel(pattern: str, recorded: Behaviour) -> None:
    """Refuse a pattern that matches no recorded channel, or, if none is recorded, no output channel."""
    channels = [(topic, name) for topic, series in recorded.series.items() for name in series.fields]
    channels = channels or [(topic.name, name) for topic in OUTPUT_TOPICS for name in topic.field_names]
    if not any(channel_matches(topic, name, pattern) for topic, name in channels):
        names = [channel_name(topic, name) for topic, name in channels]
        raise BadRequest(f"channel: nothing is called {pattern!r}; {did_you_mean(pattern, names)}")


def _changed_values(before: Any, after: Any, place: str) -> list[str]:
    """List a sentence for each value that differs between two records as JSON."""
    if isinstance(before, dict) and isinstance(after, dict):
        return [
            line for k in before for line in _changed_values(before[k], after[k], f"{place}.{k}".lstrip("."))
        ]
    return [] if before == after else [f"{place}: {before!r:.80} is {after!r:.80} now"]
