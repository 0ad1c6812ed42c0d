"""Replay: today's flight software runs on recorded sensors and commands; its outputs are compared."""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import mujoco

from fsw.config import CYCLE_HZ, configure
from fsw.dictionary.params import Params
from fsw.messages import Outputs
from fsw.state import boot, outputs_at_rest
from marsarm.replaying.compare import (
    ChannelDifference,
    Differences,
    EvrChange,
    EvrDifference,
    compare_behaviours,
)
from marsarm.replaying.inputs import (
    Behaviour,
    Inputs,
    behaviour_from_log,
    behaviour_from_outputs,
    inputs_from_log,
)
from marsarm.telemetry.events import EvrEntry, record_to_json
from marsarm.telemetry.format import LogError
from marsarm.telemetry.read import read_log
from marsarm.telemetry.recorder import IMPORT, cpu_features
from marsarm.telemetry.topics import channel_matches, channel_name
from sim.arms import params_over
from sim.loop import step_flight_software
from sim.params import BadParams
from sim.scenario.records import did_you_mean
from simgap.common.console import pluralize
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
    """Replay a log and compare the outputs; BadRequest if something given cannot be used or compared."""
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
    # the same instruction sets and kernels
    same = log.header.get("cpu") == json.dumps(cpu_features())
    differences = compare_behaviours(
        recorded,
        behaviour_from_outputs(run_flight_software(inputs, params, progress)),
        tolerance=0.0 if same else OTHER_PROCESSOR_TOLERANCE,
        chosen=partial(channel_matches, pattern=request.channel),
    )
    if differences.driven_tick is not None:
        notes = (
            *notes,
            f"the joints are driven otherwise from {_at(differences.driven_tick)} on; the sensors answer the "
            "recorded drive, so what comes later is no prediction",
        )
    changed = tuple(_changed_values(record_to_json(inputs.params), record_to_json(params), ""))
    return ReplayReport(request, dict(log.header), differences, changed, notes, same)


def run_flight_software(inputs: Inputs, params: Params, progress: Progress) -> list[Outputs]:
    """Run today's flight software on recorded inputs, to their end or a software error; outputs by cycle."""
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


def _check_channel(pattern: str, recorded: Behaviour) -> None:
    """Refuse a pattern that matches no recorded channel."""
    channels = [(topic, name) for topic, series in recorded.series.items() for name in series.fields]
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


MAX_EVRS: Final = 30
"""Events on the console; the document has all."""


def replay_document(report: ReplayReport) -> dict[str, Any]:
    """Collect a replay and its differences from the recorded run."""
    found, header = report.differences, report.header
    return {
        "log": report.request.log,
        "recorded_by": {key: header.get(key) for key in ("marsarm", "git", "numpy", "mujoco", "python")},
        "same_processor": report.same_processor,
        "changed_params": report.changed_params,
        "notes": report.notes,
        "identical": found.identical,
        "tolerance": found.tolerance,
        "ticks": _sides(*found.ticks),
        "evrs": [
            {
                "kind": one.kind,
                "tick": one.event.tick,
                **_sides(_evr_document(one.recorded), _evr_document(one.replayed)),
            }
            for one in found.evrs
        ],
        "lengths": found.lengths,
        "channels": [_channel_document(one) for one in found.channels],
        "channels_compared": found.channels_compared,
        "not_compared": found.not_compared,
    }


def _sides(recorded: Any, replayed: Any) -> dict[str, Any]:
    return {"recorded": recorded, "replayed": replayed}


def _evr_document(evr: EvrEntry | None) -> dict[str, Any] | None:
    if evr is None:
        return None
    return {"tick": evr.tick, "name": evr.name, "message": evr.message, "fields": evr.fields}


def _channel_document(one: ChannelDifference) -> dict[str, Any]:
    document = asdict(one) | {"at_first": _sides(*one.at_first)}
    del document["profile"]  # a number for each tick
    return document


def replay_parts(report: ReplayReport) -> list[str]:
    """Show a replay: events first, then lengths, then channel by channel."""
    header = report.header
    processor = (
        "processor another than recorded it (cpu in the header): numbers are compared to "
        f"{report.differences.tolerance:g}"
    )
    return [
        f"{report.request.log}: {verdict_line(report.differences)}",
        f"recorded  by marsarm {header.get('marsarm')}, git {header.get('git')}, numpy {header.get('numpy')}",
        *([] if report.same_processor else [processor]),
        *(f"parameter {line}" for line in report.changed_params),
        *(f"note      {line}" for line in report.notes),
        *difference_lines(report.differences),
    ]


def verdict_line(found: Differences) -> str:
    """Return one line that says whether two runs are the same."""
    ticks = f"{pluralize(found.ticks[0], 'tick')}, {found.ticks[0] / CYCLE_HZ:.1f} s"
    if found.identical:
        same = "identical" if found.tolerance == 0 else f"the same to {found.tolerance:g}"
        return f"{same}: {ticks}, {pluralize(found.channels_compared, 'channel')}"
    return (
        f"DIFFERENT: {pluralize(len(found.evrs), 'event')}, {pluralize(len(found.lengths), 'length')}, "
        f"{len(found.channels)} of {pluralize(found.channels_compared, 'channel')}; "
        f"{ticks}, {found.ticks[1]} replayed"
    )


def difference_lines(found: Differences) -> Iterator[str]:
    """Yield the lines of the differences between two runs."""
    yield from (f"note      {line}" for line in found.not_compared)
    yield from (_evr_line(one) for one in found.evrs[:MAX_EVRS])
    if len(found.evrs) > MAX_EVRS:
        yield f"event     and {len(found.evrs) - MAX_EVRS} more; --json lists all"
    for n in found.lengths:
        yield (
            f"length    {n.topic}: {n.recorded} recorded, {n.replayed} replayed, apart from "
            f"{_at(n.first_tick)} on"
        )
    for c in found.channels:
        yield (
            f"channel   {_component_name(c.channel, c.component)}: from {_at(c.first_tick)} on, at {c.ticks} "
            f"of {c.compared} ticks, by up to {c.greatest:.3g} at {_at(c.greatest_tick)}"
        )
        first, values = _component_name(c.channel, c.first_component), c.at_first
        yield f"          {first} at {_at(c.first_tick)}: recorded {values[0]!r}, replayed {values[1]!r}"


def _at(tick: int) -> str:
    return f"tick {tick} ({tick / CYCLE_HZ:.2f} s)"


def _evr_line(one: EvrDifference) -> str:
    line = f"event     {_at(one.event.tick)}  {one.kind.value}  {one.event.name}: {one.event.message}"
    if one.kind is EvrChange.CHANGED:
        assert one.replayed is not None
        line += f"  ->  {one.replayed.name}: {one.replayed.message}"
    return line


def _component_name(channel: str, component: tuple[int, ...]) -> str:
    return channel + "".join(f"[{k}]" for k in component)
