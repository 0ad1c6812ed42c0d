"""Run as a view shows it: its scene, its arms and its events."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.dictionary.evrs import Severity
from fsw.dictionary.params import Params
from fsw.kinematics.arm import build_arm
from fsw.kinematics.transforms import Array, normalize
from marsarm.telemetry.events import BadJson, record_from_json
from marsarm.telemetry.format import EVR_TOPIC, TICK_NS
from marsarm.telemetry.read import Log, read_log
from marsarm.telemetry.recorder import WORLD
from marsarm.view.frames import Event, Samples, ViewFrames, compute_frames
from marsarm.view.scene import Scene, build_scene
from sim.arm_model.load import ArmModel
from sim.arms import BuiltArm, UnknownArm, arm_named
from sim.effects.effect import Effect, params_with_effects
from sim.effects.structure import StandInTurret
from sim.scenario.effects import BadEffect, parse_effect_text
from sim.setting import World
from simgap.common.errors import BadRequest

MOST_COMMANDS: Final = 3
"""Largest number of commands in a title, which then fits a line."""


@dataclass(frozen=True, slots=True, eq=False)
class Plot:
    """Curves of one unit over the time of the frames."""

    title: str
    unit: str
    values: Mapping[str, Array]
    """Values of each curve by its label, shape (n,)."""


def make_plots(frames: ViewFrames) -> tuple[Plot, ...]:
    """Make the plots of a run; those of the truth only if it is known."""
    samples = frames.samples
    plots = [Plot("joint angle", "deg", _by_joint(np.degrees(samples.believed_rad)))]
    if samples.true_rad is not None:
        plots.append(
            Plot(
                "true less believed angle", "mrad", _by_joint(1e3 * (samples.true_rad - samples.believed_rad))
            )
        )
    plots.append(Plot("motor current", "A", _by_joint(samples.current_A)))
    if samples.force_N is not None:
        plots.append(Plot("contact force", "N", {"tool": samples.force_N}))
    return tuple(plots)


def _by_joint(values: Array) -> dict[str, Array]:
    return {joint.name.lower(): values[joint] for joint in Joint}


@dataclass(frozen=True, slots=True, eq=False)
class WatchedRun:
    """Run that is over, for a page."""

    title: str
    facts: tuple[tuple[str, str], ...]
    """Names and values of what identifies the run."""
    notes: tuple[str, ...]
    """Sentences about what is not drawn as it was."""
    scene: Scene
    frames: ViewFrames
    events: tuple[Event, ...]


def watch_log(path: Path) -> WatchedRun:
    """Prepare a log for a view; BadRequest if it cannot be read or drawn on this machine."""
    log = read_log(path, ("/joint", "/sensors", "/truth", "/tool", EVR_TOPIC))
    notes: list[str] = []
    try:
        world = _world(log, notes)
        arm, is_known = _arm(log.header)
        params = _params(log, arm.model, notes)
    except BadJson as error:
        raise BadRequest(f"log {path}: {error}") from error
    named = log.header.get("arm", "")
    if params.model.name != arm.model.name:
        raise BadRequest(
            f"log {path}: is of the drawing {params.model.name!r}, which {named!r} does not name here; call "
            f"`marsarm view` in the folder where it does, in which the run was recorded"
        )
    samples = Samples.of_log(log)
    if samples.true_rad is not None and not is_known:
        notes.append(f"This machine does not know the arm of the log, {named!r}: the true arm is not drawn.")
        samples = samples.without_truth()
    elif params.model.sha256 != arm.model.params.model.sha256:
        notes.append("The drawing has changed since the run: shapes are of today, the true arm is not drawn.")
        samples = samples.without_truth()
    effects = (*arm.effects, *_effects(log.header, arm.params.tool_names, notes))
    has_turret = not any(isinstance(effect, StandInTurret) for effect in effects)
    scene = build_scene(world, arm.model, has_turret)
    true_arm = build_arm(params_with_effects(effects, arm.model.params))
    normal = None if world.surface is None else normalize(world.surface.normal_N)
    frames = compute_frames(scene, samples, build_arm(params), true_arm, normal)
    if log.end_note:
        notes.append(f"Log: {log.end_note}.")
    if "/truth" not in log.packets:
        notes.append("The log has no truth: only the arm that flight software believes is drawn.")
    events = tuple(Event(one.tick * TICK_NS / 1e9, Severity(one.severity), one.message) for one in log.evrs)
    facts = list_facts(log.header)
    return WatchedRun(_title(log.header), facts, tuple(notes), scene, frames, events)


def _title(header: Mapping[str, str]) -> str:
    """Return the first commands of a run in words; nothing for a log without commands."""
    commands = [
        " ".join(filter(None, (one["type"], one["fields"].get("tool"))))
        for one in _parse(header.get("commands", "[]"))
    ]
    more = [f"{len(commands) - MOST_COMMANDS} more"] if len(commands) > MOST_COMMANDS else []
    return ", ".join(commands[:MOST_COMMANDS] + more)


def list_facts(header: Mapping[str, str]) -> tuple[tuple[str, str], ...]:
    """List names and values of what identifies a run, from the header of its log."""
    names = {
        "arm": "arm",
        "seed": "seed",
        "marsarm": "marsarm",
        "git": "commit",
        "params_sha256": "parameters",
    }
    return tuple((text, header[name][:40]) for name, text in names.items() if name in header)


def _world(log: Log, notes: list[str]) -> World:
    if WORLD not in log.header:
        notes.append(
            "The log does not say where rock and ground were: they are drawn level and without rock."
        )
        return World()
    world: World = record_from_json(World, _parse(log.header[WORLD]), WORLD, notes)
    return world


def _params(log: Log, drawing: ArmModel, notes: list[str]) -> Params:
    if "params" not in log.header:
        notes.append("The log has no parameters: the believed arm is that of the drawing.")
        return drawing.params
    # what another version of the parameters lacks changes no picture
    params: Params = record_from_json(Params, _parse(log.header["params"]), "params", [], drawing.params)
    return params


def _parse(text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise BadJson(f"header: no JSON ({error})") from error


def _arm(header: Mapping[str, str]) -> tuple[BuiltArm, bool]:
    """Return the arm of a log and True, or the default drawing and False if this machine does not know it."""
    try:
        return arm_named(header["arm"]), True
    except (KeyError, UnknownArm):
        return arm_named("nominal"), False


def _effects(header: Mapping[str, str], tools: Sequence[str], notes: list[str]) -> tuple[Effect, ...]:
    """Return the effects of a run as far as this machine knows them."""
    try:
        return tuple(parse_effect_text(text, tools) for text in _parse(header.get("effects", "[]")))
    except (BadEffect, BadJson) as error:
        notes.append(f"The true arm is drawn without the effects of the run: {error}.")
        return ()
