"""Run as a view shows it: its scene, its arms, its events, and frames: poses of the arms over time.

This is the one way from a run to what is drawn: the page and the tests use it.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.evrs import Severity
from fsw.dictionary.params import Params
from fsw.kinematics.arm import Arm, build_arm
from fsw.kinematics.chain import Frames as ChainFrames
from fsw.kinematics.chain import forward, tool_pose
from fsw.kinematics.statics import ToolForce, settle_output
from fsw.kinematics.transforms import Array, Pose, normalize, stack_poses
from marsarm.telemetry.events import BadJson, record_from_json
from marsarm.telemetry.format import EVR_TOPIC, SAMPLE_CYCLES, TICK_NS
from marsarm.telemetry.read import Log, read_log
from marsarm.telemetry.recorder import WORLD
from marsarm.view.scene import Scene, build_scene
from sim.arm_model.load import ArmModel
from sim.arms import BuiltArm, UnknownArm, arm_named
from sim.effects.effect import Effect, params_with_effects
from sim.effects.structure import StandInTurret
from sim.scenario.effects import BadEffect, parse_effect_text
from sim.setting import World
from simgap.common.errors import BadRequest

MOST_SAMPLES: Final = 2000
"""Largest number of samples of a log; in half an hour, a joint turns by 5 degrees at most between two."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """State of the arm at n times, true and as flight software believes it; joint arrays are (5, n)."""

    time_s: Array
    """Time since boot, shape (n,)."""
    mode: NDArray[np.intp]
    """Mode of the arm, shape (n,)."""
    tool: NDArray[np.intp]
    """Tool of the last tool command, the first one before it, shape (n,)."""
    motor_rad: Array
    """Motor angles that flight software measures."""
    believed_rad: Array
    """Output angles that flight software estimates."""
    gravity_R_m_s2: Array
    """Gravity in the rover frame that the rover measures, shape (3, n)."""
    current_A: Array
    true_rad: Array | None
    """True output angles; None if they are not known."""
    force_N: Array | None
    """True contact force, shape (n,); None if it is not known."""

    @classmethod
    def of_log(cls, log: Log) -> Self:
        """Select at most MOST_SAMPLES of a log at regular times; BadRequest without joints or gravity."""
        missing = [topic for topic in ("/joint", "/sensors") if topic not in log.packets]
        if missing:
            raise BadRequest(f"log {log.path}: has no {missing[0]}, which a view needs; record it with --log")
        ticks, joint = log.ticks("/joint"), log["/joint"]
        period = max(SAMPLE_CYCLES, -(-int(np.ptp(ticks) + 1) // (MOST_SAMPLES - 1)))
        rows = np.unique(
            np.searchsorted(ticks, np.arange(ticks[0], ticks[-1] + period, period)).clip(0, len(ticks) - 1)
        )
        at = ticks[rows]
        sensors, truth = log["/sensors"][_rows_at(log, "/sensors", at)], None
        if "/truth" in log.packets:
            truth = log["/truth"][_rows_at(log, "/truth", at)]
        tool = (
            log["/tool"]["tool"][_rows_at(log, "/tool", at)] if "/tool" in log.packets else np.zeros(len(at))
        )
        return cls(
            time_s=at / CYCLE_HZ,
            mode=joint["mode"][rows].astype(np.intp),
            tool=tool.astype(np.intp),
            motor_rad=joint["motor_rad"][rows].T,
            believed_rad=joint["output_rad"][rows].T,
            gravity_R_m_s2=sensors["gravity_R_m_s2"].T,
            current_A=sensors["current_A"].T,
            true_rad=None if truth is None else truth["output_rad"].T,
            force_N=None if truth is None else truth["contact_force_N"],
        )

    def select_known(self) -> Self:
        """Return the samples in which flight software has finite angles, and the rover finite gravity."""
        is_known = np.isfinite(np.vstack([self.believed_rad, self.motor_rad, self.gravity_R_m_s2])).all(
            axis=0
        )
        values: dict[str, Any] = {field.name: getattr(self, field.name) for field in fields(self)}
        known: dict[str, Any] = {n: v if v is None else v[..., is_known] for n, v in values.items()}
        return replace(self, **known)

    def without_truth(self) -> Self:
        """Return the samples without what only a simulator knows."""
        return replace(self, true_rad=None, force_N=None)

    @property
    def mode_names(self) -> list[str]:
        """Names of the modes in words."""
        return [Mode(number).name.lower().replace("_", " ") for number in self.mode]


def _rows_at(log: Log, topic: str, ticks: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the row of the last message of a topic at each tick, or of the first one, shape (n,)."""
    return (np.searchsorted(log.ticks(topic), ticks, side="right") - 1).clip(0)


@dataclass(frozen=True, slots=True)
class Event:
    """Event report for the time line."""

    time_s: float
    severity: Severity
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class ViewFrames:
    """Poses at n times of b carriers and, as the last one, of the tool, in world axes.

    Offsets are what compliance, backlash and errors of the arm add to the rigid arm at its motor angles. A
    view magnifies them.
    """

    samples: Samples
    p_m: NDArray[np.float32]
    """Positions of the rigid arm, shape (n, b + 1, 3)."""
    q: NDArray[np.float32]
    """Quaternions x, y, z, w of the rigid arm, continuous in time, shape (n, b + 1, 4)."""
    believed: NDArray[np.float32]
    """Offsets of the arm of flight software: translation [m], rotation [rad], shape (n, b + 1, 6)."""
    true: NDArray[np.float32] | None
    """Offsets of the true arm likewise; None if it is not known."""
    force_N: NDArray[np.float32]
    """True contact force on the tool, shape (n, 3)."""

    @property
    def trail_start(self) -> NDArray[np.uint32]:
        """Frame since which the tool is the same, shape (n,): another tool begins another trail."""
        is_first = np.append(True, np.diff(self.samples.tool) != 0)
        return np.maximum.accumulate(np.where(is_first, np.arange(len(is_first)), 0)).astype(np.uint32)

    @property
    def tool_error_m(self) -> Array | None:
        """Distance between the true tool and where flight software believes it, shape (n,)."""
        if self.true is None:
            return None
        return np.asarray(np.linalg.norm(self.true[:, -1, :3] - self.believed[:, -1, :3], axis=1), float)


def compute_frames(
    scene: Scene, samples: Samples, believed_arm: Arm, true_arm: Arm, surface_normal_R: Array | None
) -> ViewFrames:
    """Compute the frames of a run, by the parameters of flight software and as the arm was built.

    The springs of the true arm are in equilibrium with gravity and with the contact force: the arm is slow.
    The unit normal of the surface is in the rover frame, (3,). BadRequest says that no sample has all angles
    and gravity, or that one has a tool that the arm lacks.
    """
    samples = samples.select_known()
    if not len(samples.time_s):
        raise BadRequest("log: has no finite angles of the joints with gravity; there is no arm to show")
    if samples.tool.max() >= len(believed_arm.X_FT):
        raise BadRequest(
            f"log: has tool {samples.tool.max()}, and its parameters have the tools 0 to "
            f"{len(believed_arm.X_FT) - 1}; it cannot be drawn"
        )
    rigid = _poses(scene, believed_arm, forward(believed_arm, samples.motor_rad), samples)
    gravity = samples.gravity_R_m_s2
    settled = settle_output(believed_arm, samples.believed_rad, gravity).frames
    believed = _offset(rigid, _poses(scene, believed_arm, settled, samples))
    true, force_R_N = None, np.zeros((3, len(samples.time_s)))
    if samples.true_rad is not None and samples.force_N is not None:
        if surface_normal_R is not None:
            force_R_N = surface_normal_R[:, None] * samples.force_N
        settled = _settle_true(true_arm, samples, samples.true_rad, force_R_N)
        true = _offset(rigid, _poses(scene, true_arm, settled, samples))
    return ViewFrames(
        samples=samples,
        p_m=np.moveaxis(rigid.p, 0, -1).swapaxes(0, 1).astype(np.float32),
        q=_quaternions(rigid.R),
        believed=believed,
        true=true,
        force_N=(scene.X_WR.R @ force_R_N).T.astype(np.float32),
    )


def _settle_true(arm: Arm, samples: Samples, true_rad: Array, force_R_N: Array) -> ChainFrames:
    """Return the frames of the true arm, each under the force on its tool."""
    strain = np.zeros((6, 6, len(samples.time_s)))
    for tool in np.unique(samples.tool):
        at = samples.tool == tool
        push = ToolForce(list(arm.X_FT)[tool], force_R_N[:, at])
        strain[..., at] = settle_output(arm, true_rad[:, at], samples.gravity_R_m_s2[:, at], push).strain
    return forward(arm, true_rad, strain)


def _poses(scene: Scene, arm: Arm, frames: ChainFrames, samples: Samples) -> Pose:
    """Compute the poses of carriers and tool in world axes, batch (b + 1, n)."""
    carriers = scene.carrier_poses(frames)
    tools = stack_poses([tool_pose(arm, frames, tool) for tool in arm.X_FT])
    times = np.arange(len(samples.time_s))
    tool = Pose(scene.X_WR.R[..., None], scene.X_WR.p[..., None]) @ tools[times, samples.tool]
    return Pose(
        np.concatenate([carriers.R, tool.R[:, :, None]], axis=2),
        np.concatenate([carriers.p, tool.p[:, None]], axis=1),
    )


def _offset(rigid: Pose, other: Pose) -> NDArray[np.float32]:
    turn = np.einsum("ik...,jk...->...ij", other.R, rigid.R)
    rotation = Rotation.from_matrix(turn.reshape(-1, 3, 3)).as_rotvec().reshape(*turn.shape[:2], 3)
    offset = np.concatenate([np.moveaxis(other.p - rigid.p, 0, -1), rotation], axis=-1)
    return np.asarray(offset.swapaxes(0, 1), np.float32)


def _quaternions(R: Array) -> NDArray[np.float32]:
    """Return quaternions of which two that follow each other have the same sign, shape (n, b + 1, 4)."""
    matrices = np.moveaxis(R, (0, 1), (-2, -1)).swapaxes(0, 1)
    q = Rotation.from_matrix(matrices.reshape(-1, 3, 3)).as_quat().reshape(*matrices.shape[:2], 4)
    flips = np.sign(np.sum(q[1:] * q[:-1], axis=-1))
    q[1:] *= np.cumprod(np.where(flips < 0, -1.0, 1.0), axis=0)[..., None]
    return np.asarray(q, np.float32)


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
