"""Diagnose a robot: from its model and its logs to where, which effect, how far."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from simgap.arrays import Array
from simgap.assemble import assemble, select_sure
from simgap.catalogue.catalogue import base_effects, catalogue
from simgap.checks.commands import count_foreign_commands
from simgap.checks.records import COARSE_RAD, REFUSED, Audit, joint_samples
from simgap.common.errors import RobotError
from simgap.effects.effect import Effect, JointEffect
from simgap.effects.variation import Variation, unbound
from simgap.files.columns import hint_at
from simgap.logs import Logs, Motion, Usable
from simgap.report.traces import convert_errors
from simgap.residuals.conditioned import Change, KnownResiduals, changes_of
from simgap.residuals.encoder_residuals import why_refused
from simgap.residuals.residuals import ResidualModel, refer_to
from simgap.residuals.simulation_residuals import ResidualKind, list_kinds
from simgap.result import Base, Diagnosis, Rejected
from simgap.robot import ControlMode, Robot
from simgap.selection.checkpoint import Checkpoint, Meter, Progress, find_steps
from simgap.selection.context import Selection
from simgap.selection.selection import select_effects

FOREIGN_SHARE: Final = 0.25
"""Share of motions that follow another command from which commands count as mixed up.
In the logs of the XL330 and the SO-101 it is at most 2 of 27. With shuffled commands it is at least 8 of 16,
where four gains share commands."""


def diagnose(
    robot: Robot,
    motions: Sequence[Motion],
    *,
    held_out: Sequence[Motion] = (),
    effects: Sequence[Effect] = (),
    start: Mapping[Effect, Array] | None = None,
    base_only: bool = False,
    audit: Audit | None = None,
    seed: int = 1,
    progress: Progress = lambda share, text: None,
    cache: str | Path | None = None,
) -> Diagnosis:
    """Find the effects that make a robot differ from its model.

    Args:
        robot: The robot with its model.
        motions: Motions that are fitted.
        held_out: Motions that only judge.
        effects: Effects of one's own, which join the catalogue.
        start: Effects of an earlier result with their sizes, (n_sizes,) in the units of their names. They
            are part of the model; base parameters are fitted from there, and changes of others may be found.
        base_only: Fit the base parameters, and look for no effect; this takes a twentieth of the time.
        audit: Audit of all these motions; the samples that it refuses take no part.
        seed: Seed of the folds: the same seed gives the same bits.
        progress: Called with the share that is done, from 0 to 1, and a text.
        cache: Folder for the steps of an unfinished diagnosis: after an interruption, the same call goes on
            from them. They are deleted at the end. None: nothing is kept.

    Raises:
        RobotError: The motions are too few, are both fitted and held out, or do not follow their commands;
            the audit has a remark that refuses logs, or refuses all samples; the logs show no base parameter
            where they alone are wanted; or two effects have one name.
    """
    usable = None
    if audit is not None:
        check_audit(audit, motions)
        names = [(motion.name, joint) for motion in (*motions, *held_out) for joint in motion.joints]
        usable = {(motion, joint): audit.is_usable(motion, joint) for motion, joint in names}
    check_motions(robot, motions, held_out)
    kinds = _list_kinds(robot, motions, usable, base_only)
    logs = Logs(tuple(motions))
    given = dict(start or {})
    known = [] if base_only else [*catalogue(robot, logs), *effects]
    known += list_variations(robot, logs, known)
    check_names(known)
    known = _replace_known(known, given, base_effects(robot, logs))
    parts = []
    steps = None
    if cache is not None and not base_only:
        own = (*effects, *given, *changes_of(given))
        steps = find_steps(cache, robot, motions, held_out, usable, own, seed)
    with Checkpoint(steps, known) as checkpoint:
        for k, kind in enumerate(kinds):
            meter = Meter(_part_of(progress, k, len(kinds)))
            acting = {one: size for one, size in given.items() if kind.shows(one)}
            fitted = _know(kind.make(motions, False), acting)
            # may refuse: before the long work
            judge = _know(kind.make(held_out, True), acting) if held_out else fitted
            shown, rejected = choose_shown(robot, kind, known)
            base = _list_base(robot, logs, kind, given)
            selection = select_effects(
                fitted, base, shown, seed=seed, n_kinds=len(kinds), meter=meter, checkpoint=checkpoint
            )
            judge = refer_to_chosen(judge, base, selection) if held_out else judge
            selection, sets, withdrawn = select_sure(selection, judge if held_out else None)
            fitted = refer_to_chosen(fitted, base, selection)
            judge = refer_to_chosen(judge, base, selection) if held_out else fitted
            part = _add_start(assemble(robot, fitted, selection, sets, judge), acting)
            parts.append(replace(part, rejected=(*withdrawn, *rejected)))
    progress(1.0, "done")
    return replace(
        convert_errors(robot, join_parts(parts, _list_neutral(robot, logs, known))),
        seed=seed,
        is_base_only=base_only,
        refused=() if audit is None else audit.refused,
        remarks=() if audit is None else tell_remarks(audit),
        fitted_motions=tuple(motion.name for motion in motions),
        judged_motions=tuple(motion.name for motion in held_out),
    )


def _list_base(
    robot: Robot, logs: Logs, kind: ResidualKind, start: Mapping[Effect, Array]
) -> list[JointEffect]:
    """List the base parameters of a kind of residual, which count from an earlier result."""
    before = {one.key: float(size[0]) for one, size in start.items()}
    return [
        replace(one, known=before.get(one.key, 0.0))
        for one in base_effects(robot, logs)
        if kind.has_base and kind.shows(one)
    ]


def _list_kinds(
    robot: Robot, motions: Sequence[Motion], usable: Usable | None, base_only: bool
) -> list[ResidualKind]:
    """List the kinds of residual that logs allow, or refuse logs without one that has base parameters."""
    kinds = [one for one in list_kinds(robot, motions, usable) if one.has_base or not base_only]
    if not kinds:
        raise RobotError(
            "the logs have no command and no torque, so that they show no base parameter; diagnose with the "
            "whole catalogue"
        )
    return kinds


def list_variations(robot: Robot, logs: Logs, known: Sequence[Effect]) -> list[Effect]:
    """List effects that may follow a condition, if it is not always neutral; RobotError for a wrong name."""
    found: list[Effect] = []
    candidates = [*base_effects(robot, logs), *known]
    for condition, table in (robot.file.conditions if robot.file and known else {}).items():
        largest = max(abs(motion.conditions[condition] - table.neutral) for motion in logs.fit)
        for name in table.effects:
            own = [one for one in candidates if one.name.lower() == name.lower()]
            if not own:
                there = sorted({one.name for one in candidates})
                hint = hint_at(name, there, "there are")
                raise RobotError(
                    f"conditions.{condition}.effects: no joint can have the effect {name!r}; {hint}"
                )
            if largest > 0.0:
                found += [Variation(one.place, unbound(one), condition, largest) for one in own]
    return found


def _list_neutral(robot: Robot, logs: Logs, known: Sequence[Effect]) -> tuple[Rejected, ...]:
    """List the effects that cannot follow a condition, as it is neutral in all fitted motions."""
    return tuple(
        Rejected(
            "any joint", f"{name} by {condition}", f"{condition} is {table.neutral:g} in all fitted motions"
        )
        for condition, table in (robot.file.conditions if robot.file and known else {}).items()
        for name in table.effects
        if all(motion.conditions[condition] == table.neutral for motion in logs.fit)
    )


def _part_of(progress: Progress, part: int, parts: int) -> Progress:
    """Return the progress of one of some parts that are taken to last alike."""
    return lambda share, text: progress((part + share) / parts, text)


def choose_shown(
    robot: Robot, kind: ResidualKind, known: Sequence[Effect]
) -> tuple[list[Effect], list[Rejected]]:
    """Return the effects that compete, and those that get no name whatever the fit says, with the reason."""
    shown = [effect for effect in known if kind.shows(effect)]
    if kind.has_base:
        return shown, []
    reasons = [(effect, why_refused(robot, effect)) for effect in shown]
    rejected = [Rejected(effect.place, effect.name, reason) for effect, reason in reasons if reason]
    return [effect for effect, reason in reasons if not reason], rejected


def refer_to_chosen(model: ResidualModel, base: Sequence[Effect], selection: Selection) -> ResidualModel:
    """Return residuals whose reference is what was chosen."""
    every = [*base, *selection.chosen.effects]
    return refer_to(model, every, selection.chosen.sizes[selection.context.union.columns(every)])


def _know(model: ResidualModel, known: Mapping[Effect, Array]) -> ResidualModel:
    """Return residuals about known effects; the same if there are none."""
    return KnownResiduals(model, known) if known else model


def _replace_known(
    effects: Sequence[Effect], start: Mapping[Effect, Array], base: Sequence[Effect]
) -> list[Effect]:
    """Replace effects of an earlier result, but for base parameters, by their changes, which compete."""
    fitted = {one.key for one in base}
    changes = [one for one in changes_of(start) if one.effect.key not in fitted]
    keys = {one.effect.key for one in changes}
    return [*(one for one in effects if one.key not in keys), *(changes if effects else ())]


def _add_start(part: Diagnosis, start: Mapping[Effect, Array]) -> Diagnosis:
    """Add the effects of an earlier result to one that counts from it."""
    if not start:
        return part
    before = {one.key: size for one, size in start.items()}
    total = {one.key: (one, size.copy()) for one, size in start.items()}
    for effect, size in zip(part.effects, part.sizes, strict=True):
        one = effect.effect if isinstance(effect, Change) else effect
        known = before.get(one.key, np.zeros(len(size)))
        whole, _ = total.get(one.key, (one, None))
        bounds = np.array([(each.low, each.high) for each in whole.sizes]).T
        total[one.key] = whole, np.clip(known + size, *bounds)
    base = []
    for each in part.base:
        place = next((key for key, (one, _) in total.items() if _is_base(one, each)), "")
        by = float(before[place][0]) if place in before else 0.0
        low, high = each.interval
        moved = replace(each, nominal=each.nominal + by, value=each.value + by)
        base.append(replace(moved, interval=(low + by, high + by)))
    return replace(
        part,
        base=tuple(base),
        effects=tuple(one for one, _ in total.values()),
        sizes=tuple(tuple(size.tolist()) for _, size in total.values()),
        start=tuple(tuple(before.get(key, 0.0 * size).tolist()) for key, (_, size) in total.items()),
        findings=tuple(replace(one, next_motion="") for one in part.findings),
        rivals=(),  # their sizes are changes
        effect_kinds=(part.kind,) * len(total),
    )


def _is_base(effect: Effect, one: Base) -> bool:
    """Return whether an effect has a base parameter."""
    return effect.place == one.place and [size.name for size in effect.sizes] == [one.name]


def join_parts(parts: Sequence[Diagnosis], rejected: tuple[Rejected, ...]) -> Diagnosis:
    """Join the results of several kinds of residual, and what none of them could name."""
    lists = (
        *("findings", "base", "errors", "remaining", "rejected"),
        *("effects", "sizes", "start", "effect_kinds", "rivals"),
    )
    joined: dict[str, Any] = {name: sum((getattr(part, name) for part in parts), ()) for name in lists}
    joined["rejected"] += rejected
    kinds, methods = [part.kind for part in parts], [part.method for part in parts]
    return replace(parts[0], kind=" and ".join(kinds), method=" ".join(methods), **joined)


def check_motions(robot: Robot, motions: Sequence[Motion], held_out: Sequence[Motion]) -> None:
    """Refuse by RobotError motions that are too few, in both parts, or do not follow their commands."""
    twice = _find_repeated([motion.name for motion in motions])
    if twice is not None:
        raise RobotError(f"motion {twice}: is fitted twice; give each motion once, with its own name")
    for motion in held_out:
        same = next((one.name for one in motions if one.name == motion.name or is_copy(one, motion)), None)
        if same is not None:
            copied = f" as {same}" if same != motion.name else ""
            raise RobotError(
                f"motion {motion.name} is held out and is fitted{copied}; a motion can be one of both"
            )
    if not motions:
        raise RobotError("no motion is fitted; a diagnosis needs one at least, and better four")
    check_commands(robot, (*motions, *held_out))


def check_commands(robot: Robot, motions: Sequence[Motion]) -> None:
    """Refuse by RobotError motions that do not follow their commands."""
    for joint in robot.joints:
        if joint.mode is not ControlMode.POSITION:
            continue
        logs = [one.joints[joint.name] for one in motions if joint.name in one.joints]
        moving = [
            (log.position, log.command)
            for log in logs
            if log.command is not None and np.ptp(joint_samples(log).position) > COARSE_RAD * joint.per_rad
        ]
        wrong = count_foreign_commands(moving)
        if wrong > max(1.0, FOREIGN_SHARE * len(moving)):
            raise RobotError(
                f"joint {joint.name}: {wrong} of {len(moving)} motions follow the command of another motion "
                "better than their own; each motion needs its own command"
            )


def check_audit(audit: Audit, motions: Sequence[Motion]) -> None:
    """Refuse by RobotError logs that say something else than happened, or have no usable sample.

    Effects would explain a wrong unit, exchanged joints, lost turns, or a position that never changes.
    """
    for one in audit.remarks:
        if one.kind in REFUSED:
            raise RobotError(f"{f'joint {one.joint}' if one.joint else 'logs'}: {one.kind}; {one.text}")
    if not any(audit.is_usable(motion.name, joint).any() for motion in motions for joint in motion.joints):
        reasons = ", ".join(dict.fromkeys(one.reason for one in audit.refused))
        raise RobotError(
            f"no sample of the fitted motions can be used ({reasons}); `simgap check` shows where"
        )


def tell_remarks(audit: Audit) -> tuple[str, ...]:
    """Return a sentence for each remark on the logs."""
    return tuple(end_sentence(f"{one.joint or 'robot'}: {one.kind}: {one.text}") for one in audit.remarks)


def end_sentence(text: str) -> str:
    """Return a text with a full stop, unless it ends with one or with a question."""
    return text if text.endswith((".", "?")) else f"{text}."


def check_names(effects: Sequence[Effect]) -> None:
    """Refuse two effects of one name at one place; RobotError if two have the same key."""
    twice = _find_repeated([effect.key for effect in effects])
    if twice is not None:
        raise RobotError(f"effects: two have the key {twice!r}; give yours another name, and each file once")


def _find_repeated(names: Sequence[str]) -> str | None:
    """Return the first name that stands there twice, or None."""
    return next((name for k, name in enumerate(names) if name in names[:k]), None)


def is_copy(one: Motion, other: Motion) -> bool:
    """Return whether two motions have the same positions, in which something moves."""
    if one.joints.keys() != other.joints.keys():
        return False
    pairs = [(log.position.value, other.joints[name].position.value) for name, log in one.joints.items()]
    return all(np.array_equal(*pair) for pair in pairs) and any(np.ptp(first) > 0.0 for first, _ in pairs)
