"""Diagnose a robot: from its model and its logs to where, which effect, how far."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from diagnosis.arrays import Flags
from diagnosis.assemble import assemble
from diagnosis.catalogue import base_effects, catalogue
from diagnosis.effects.effect import Effect
from diagnosis.errors import RobotError
from diagnosis.logs import Logs, Motion, Signal
from diagnosis.result import Diagnosis, Refusal
from diagnosis.robot import Robot
from diagnosis.selection import select_effects
from diagnosis.simulation_residuals import SimulationResiduals
from diagnosis.verdict import doubt_findings

MIN_MOTIONS: Final = 4
"""Least motions of a fit: with fewer, no error of a left-out motion has a standard error worth the name."""
Progress = Callable[[float, str], None]


def diagnose(
    robot: Robot,
    motions: Sequence[Motion],
    *,
    held_out: Sequence[Motion] = (),
    effects: Sequence[Effect] = (),
    usable: dict[tuple[str, str], Flags] | None = None,
    refused: Sequence[Refusal] = (),
    seed: int = 1,
    progress: Progress = lambda share, text: None,
) -> Diagnosis:
    """Find the effects that make a robot differ from its model.

    Args:
        robot: The robot with its model.
        motions: Motions that are fitted.
        held_out: Motions that only judge.
        effects: Effects of one's own, which join the catalogue.
        usable: Position samples that take part, (n,) flags, by names of motion and joint; all where absent.
        refused: Samples that an audit refused, to be listed in the result.
        seed: Seed of folds and random signs: the same seed gives the same bits.
        progress: Called with the share that is done, from 0 to 1, and a text.

    Returns:
        The diagnosis.

    Raises:
        RobotError: The motions are too few, are both fitted and held out, or do not follow their commands.
    """
    check_motions(robot, motions, held_out)
    meter = _Meter(progress)
    fitted = SimulationResiduals(robot, motions, keep=usable)
    logs = Logs(tuple(motions))
    known = [*catalogue(robot, logs), *effects]
    selection = select_effects(fitted, base_effects(robot, logs), known, seed=seed, report=meter.advance)
    doubts = doubt_findings(selection)
    judge = SimulationResiduals(robot, held_out, keep=usable) if held_out else fitted
    result = assemble(robot, selection, doubts, judge)
    progress(1.0, "done")
    return replace(
        result,
        seed=seed,
        refused=tuple(refused),
        judged_motions=tuple(motion.name for motion in held_out),
    )


class _Meter:
    """Turns numbers of simulations into a share that is done; each round is taken for the last but one."""

    def __init__(self, progress: Progress) -> None:
        self.progress, self.done, self.stage, self.left = progress, 0, "", 1

    def advance(self, text: str, count: int) -> None:
        if text == "screening":
            self.left = max(self.done, count)
        self.done += count
        self.progress(min(self.done / (self.done + max(self.left, 1)), 0.99), text)
        self.left = max(self.left - count, self.done // 20)


def check_motions(robot: Robot, motions: Sequence[Motion], held_out: Sequence[Motion]) -> None:
    """Refuse motions that cannot be diagnosed.

    Args:
        robot: The robot.
        motions: Motions that are fitted.
        held_out: Motions that only judge.

    Raises:
        RobotError: The motions are too few, are both fitted and held out, or do not follow their commands.
    """
    both = sorted({motion.name for motion in motions} & {motion.name for motion in held_out})
    if both:
        raise RobotError(f"motion {both[0]} is fitted and held out; a motion can be one of both")
    if len(motions) < MIN_MOTIONS:
        raise RobotError(
            f"{len(motions)} motions are fitted; a diagnosis needs {MIN_MOTIONS} at least, "
            "because it judges effects by motions that it leaves out"
        )
    for joint in robot.joints:
        logs = [motion.joints[joint.name] for motion in motions if joint.name in motion.joints]
        wrong = count_foreign_commands(
            [(log.position, log.command) for log in logs if log.command is not None]
        )
        if 2 * wrong > len(logs):
            raise RobotError(
                f"joint {joint.name}: {wrong} of {len(logs)} motions follow the command of another motion "
                "better than their own; each motion needs its own command"
            )


def count_foreign_commands(pairs: Sequence[tuple[Signal, Signal]]) -> int:
    """Count motions whose position is closer to the command of another motion than to their own.

    Args:
        pairs: Position and command of each motion.

    Returns:
        Number of motions whose mean distance to another command is below half of that to their own.
    """
    errors = np.full((len(pairs), len(pairs)), np.inf)
    for k, (position, _) in enumerate(pairs):
        for m, (_, command) in enumerate(pairs):
            time_s = position.time_s - position.time_s[0] + command.time_s[0]
            inside = time_s <= command.time_s[-1]
            if np.mean(inside) > 0.5:
                error = position.value - np.interp(time_s, command.time_s, command.value)
                errors[k, m] = float(np.mean(np.abs(error[inside])))
    return int(np.sum(errors.min(axis=1, initial=np.inf) < 0.5 * np.diag(errors)))
