"""Controls of the diagnosis of any robot: what must be refused, what must be none, what must grow.

1. Commands shuffled between motions are refused.
2. Twins: the model with the base parameters that were fitted to one half of a robot's logs is simulated on
   the other half's commands. Residuals of all that was fitted are resampled in blocks and added. At least 17
   of 20 end as none. Findings are left out of the twin, so that the nominal robot has no effect beside it.
3. The XL330 with 20 ms added to the times of its positions: a delay is named, 20 +- 4 ms longer than the same
   model finds in the logs as they are. No other family is new.

Real logs are read where MARSARM_DATA points.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Final

import numpy as np

from simgap.arrays import Array
from simgap.common.errors import RobotError
from simgap.diagnosis import diagnose
from simgap.loading import load
from simgap.logs import Logs, Motion, Signal
from simgap.residuals.residuals import ResidualModel
from simgap.residuals.simulation_residuals import SimulationResiduals, list_kinds
from simgap.result import Diagnosis
from simgap.robot import Robot
from simgap.selection.checkpoint import Meter
from simgap.selection.context import start_context
from simgap.selection.joint_fits import fit_base
from validation.campaigns import Context, Document, keep_results
from validation.cases.robot_draw import draw_case

NONE_SHARE: Final = 17.0 / 20.0
ADDED_S: Final = 0.020
ADDED_TOLERANCE_S: Final = 0.004
BLOCK_S: Final = 0.5
"""Block of resampled residuals: ten correlation times of the noise of a servo's encoder."""
TWIN: Final = "twin of the XL330"
DELAYS: Final = ("command delay", "measurement delay")
ROBOTS: Final = Path(__file__).parents[1] / "models" / "robots"


def shuffle_commands(motions: Sequence[Motion], seed: int) -> tuple[Motion, ...]:
    """Give each motion the commands of another one: a cycle through all motions in random order."""
    order = np.random.default_rng(seed).permutation(len(motions))
    follower = dict(zip(order.tolist(), np.roll(order, 1).tolist(), strict=True))
    found = []
    for k, motion in enumerate(motions):
        other = motions[follower[k]].joints
        joints = {name: replace(log, command=other[name].command) for name, log in motion.joints.items()}
        found.append(replace(motion, joints=joints))
    return tuple(found)


def shuffle_control(robot: Robot, motions: Sequence[Motion], seed: int) -> Document:
    """Check that shuffled commands are refused: by an error, or by a diagnosis without a fitted motion."""
    try:
        found = diagnose(robot, shuffle_commands(motions, seed), seed=seed)
    except RobotError:
        return {"refused": True, "in_bounds": True}
    refused = not found.findings and not found.fitted_motions
    return {"refused": refused, "in_bounds": refused}


def delay_positions(motions: Sequence[Motion], added_s: float) -> tuple[Motion, ...]:
    """Return motions whose positions are stamped later than they were measured."""
    found = []
    for motion in motions:
        joints = {
            name: replace(log, position=Signal(log.position.time_s + added_s, log.position.value))
            for name, log in motion.joints.items()
        }
        found.append(replace(motion, joints=joints))
    return tuple(found)


def fitted_delay_s(robot: Robot, motions: Sequence[Motion], found: Diagnosis) -> float:
    """Fit the effects that a diagnosis has found to other motions, and return the sum of the delays.

    A delay that is too short for a name is not 0: that of the XL330 is several milliseconds.
    """
    (kind, *_) = list_kinds(robot, motions, None)
    context = start_context(kind.make(motions, True), found.effects, (), found.seed, Meter())
    context, fitted = fit_base(context)
    delays = [one for one in found.effects if one.name in DELAYS]
    return float(np.sum(fitted.sizes[context.union.columns(delays)]))


def make_twin(
    motions: Sequence[Motion], model: ResidualModel, found: Diagnosis, seed: int
) -> tuple[Motion, ...]:
    """Return motions as the model makes them with the effects and sizes of a diagnosis of other motions.

    Resampled residuals are added.
    """
    named = {(one.place, one.effect) for one in found.findings}
    kept = [(effect.place, effect.name) not in named for effect in found.effects]
    fitted = [one for size in found.sizes for one in size]
    base = [one * keep for size, keep in zip(found.sizes, kept, strict=True) for one in size]
    residuals, of_base = model.residuals(found.effects, np.array([fitted, base]))
    rng = np.random.default_rng(seed)
    made = []
    for motion in motions:
        k, joints = model.motions.index(motion.name), {}
        for j, name in enumerate(model.joints):
            rows = np.flatnonzero((model.motion_of == k) & (model.joint_of == j))
            log = motion.joints[name]
            others = residuals[model.joint_of == j]
            noise = _resample(others, rows.size, _block(model.time_s[rows]), rng)
            measured = np.interp(model.time_s[rows], log.position.time_s, log.position.value)
            twin = Signal(model.time_s[rows], measured - of_base[rows] + noise)
            joints[name] = replace(log, position=twin, velocity=None)
        made.append(replace(motion, joints=joints))
    return tuple(made)


def _block(time_s: Array) -> int:
    """Return the number of samples in a block."""
    return max(1, round(BLOCK_S / float(np.median(np.diff(time_s)))))


def _resample(residuals: Array, count: int, block: int, rng: np.random.Generator) -> Array:
    """Return residuals drawn in blocks, (count,), with their mean taken off."""
    starts = rng.integers(0, max(residuals.size - block, 1), size=-(-count // block))
    drawn = np.concatenate([residuals[start : start + block] for start in starts])[:count]
    return np.asarray(drawn - residuals.mean())


class Twins:
    """Twins of the second half of some logs, by a fit of the first half, which is made when it is needed."""

    def __init__(self, robot: Robot, logs: Logs, seed: int) -> None:
        self._robot, self._seed = robot, seed
        self._first, self._second = logs.motions[::2], logs.motions[1::2]

    @cached_property
    def _fitted(self) -> tuple[SimulationResiduals, Diagnosis]:
        model = SimulationResiduals(self._robot, self._second, spacing_s=0.0)
        return model, diagnose(self._robot, self._first, seed=self._seed)

    def diagnose(self, number: int) -> Document:
        """Diagnose a twin; return the effects that were named."""
        twin = make_twin(self._second, *self._fitted, number)
        found = diagnose(self._robot, twin, seed=self._seed)
        return {"named": [one.effect for one in found.findings]}


def delay_control(robot: Robot, logs: Logs, seed: int) -> Document:
    """Compare the delays of logs with those of logs whose positions are later."""
    later = delay_positions(logs.motions, ADDED_S)
    before, after = diagnose(robot, logs.motions, seed=seed), diagnose(robot, later, seed=seed)
    without_s, with_s = (fitted_delay_s(robot, motions, after) for motions in (logs.motions, later))
    names = {one.effect for one in after.findings if one.effect in DELAYS}
    others = {one.family for one in after.findings if one.effect not in DELAYS}
    new = others - {one.family for one in before.findings}
    grown_s = with_s - without_s
    return {
        "delay_s": {"as logged": without_s, "20 ms later": with_s},
        "grown_s": grown_s,
        "delays": sorted(names),
        "other_new_families": sorted(map(str, new)),
        "in_bounds": bool(names) and abs(grown_s - ADDED_S) <= ADDED_TOLERANCE_S and not new,
    }


def load_real(name: str, file: str) -> tuple[Robot, Logs] | None:
    """Load a robot and its real logs; None where they are absent."""
    folder = os.environ.get("MARSARM_DATA", "")
    path = Path(folder) / name / file
    if not folder or not path.exists():
        return None
    robot = Robot.from_toml(ROBOTS / ("pendulum" if name == "xl330" else name) / "robot.toml")
    return robot, load(robot, path)


def list_controls(seed: int, twins: int) -> dict[str, Callable[[], Document]]:
    """List the controls by name, with the work of each; those of the XL330 only where its logs are."""
    robot, logs, _ = draw_case(seed, "single", "two_joint")
    controls: dict[str, Callable[[], Document]] = {
        "shuffled": partial(shuffle_control, robot, logs.motions, seed)
    }
    xl330 = load_real("xl330", "xl330.parquet")
    if xl330 is not None:
        controls["shuffled, XL330"] = partial(shuffle_control, xl330[0], xl330[1].motions, seed)
        controls["delay, XL330"] = partial(delay_control, *xl330, seed)
        made = Twins(*xl330, seed)
        controls |= {f"{TWIN} {k}": partial(made.diagnose, k) for k in range(twins)}
    return controls


def campaign(context: Context, twins: int = 20, only: str = "") -> Document:
    """Carry out the controls whose names begin so.

    Args:
        context: Its file keeps results, from which an interrupted campaign goes on.
        twins: Number of twins.
        only: Beginning of the names.
    """
    controls = {n: w for n, w in list_controls(context.seed, twins).items() if n.startswith(only)}
    document: Document = {}
    with keep_results(context.out, context.seed) as once:
        for done, (name, work) in enumerate(controls.items()):
            context.progress(done, len(controls), name)
            document[name] = once(name, work)
    named = [document.pop(name)["named"] for name in controls if name.startswith(TWIN)]
    if named:
        none = sum(not one for one in named)
        is_right = none >= NONE_SHARE * len(named)
        document["twins, XL330"] = {"none": none, "of": len(named), "named": named, "in_bounds": is_right}
    return {**document, "in_bounds": all(one["in_bounds"] for one in document.values())}
