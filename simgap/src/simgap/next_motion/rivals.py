"""Rivals of findings: models that may be the cause instead, as a diagnosis keeps them."""

from collections.abc import Sequence
from itertools import groupby
from typing import Final

import numpy as np

from simgap.common.errors import RobotError
from simgap.effects.effect import Effect
from simgap.effects.variation import Dependent
from simgap.result import Finding, Rival
from simgap.selection.context import Context, FittedModel
from simgap.selection.verdict import EXCLUDED, ConfidenceSet

NEXT_MOTION: Final = "the motion that `simgap next` proposes"
"""What to record where rivals of a finding are left."""
MOST_RIVALS: Final = 8
"""Rivals of a finding that are kept, itself included: sets of a servo have had seven members."""


def can_be_settled(found: ConfidenceSet, chosen: Sequence[Effect]) -> bool:
    """Return whether another motion may settle a finding.

    It cannot be planned beside an effect that is chosen for some motions alone, as a change is.
    """
    has_rivals = len(found.alternatives) + len(found.excluded) > 1
    return has_rivals and not any(isinstance(one, Dependent) for one in chosen)


def list_rivals(
    context: Context, chosen: FittedModel, sets: Sequence[ConfidenceSet], findings: Sequence[Finding]
) -> tuple[Rival, ...]:
    """List each finding and the effects that may stand in its place, then those that hardly may.

    With an effect that no catalogue has, the best of those that were excluded may be wrong as the finding is.
    All are alike in doubt if the finding is not named: a model that lacks something excluded the others.
    """
    every = [
        (found, bool(finding.effects), one)
        for found, finding in zip(sets, findings, strict=True)
        for one in (*found.alternatives, *found.excluded)[:MOST_RIVALS]
        if can_be_settled(found, chosen.effects)
    ]
    rivals = []
    for found, is_named, one in every:
        sizes = chosen.sizes.copy()
        sizes[context.union.columns([found.effect])] = 0.0
        sizes[one.columns] = one.sizes[one.columns]
        own = [(each, context.union.columns([each])) for each in context.union.effects]
        fitted = [pair for pair in own if np.isin(pair[1], one.columns).all()]
        beside = [pair for pair in own if np.any(sizes[pair[1]]) and not np.isin(pair[1], one.columns).all()]
        if any(isinstance(effect, Dependent) for effect, _ in (*fitted, *beside)):
            continue
        rivals.append(
            Rival(
                finding=found.effect.key,
                effect=one.effect.key,
                p=one.p if is_named else 1.0,
                kind=context.model.kind,
                effects=tuple(effect for effect, _ in (*fitted, *beside)),
                sizes=tuple(tuple(sizes[columns].tolist()) for _, columns in (*fitted, *beside)),
                n_fitted=len(fitted),
            )
        )
    return tuple(rivals)


def choose_rivals(rivals: Sequence[Rival]) -> list[Rival]:
    """Return the finding in most doubt, whose most probable rival is more so than others', and its rivals.

    Raises:
        RobotError: No finding has a rival.
    """
    if not rivals:
        raise RobotError(
            "no finding has a rival; an effect must be found, without an earlier result, and others compete"
        )
    groups = [list(own) for _, own in groupby(rivals, key=lambda one: (one.kind, one.finding))]
    doubtful = [own for own in groups if len(own) > 1]
    if not doubtful:
        raise RobotError(
            "no finding may have another cause, so that no motion is needed to tell causes apart; motions of "
            "another kind may show more"
        )
    return max(doubtful, key=_doubt)


def is_sure(group: Sequence[Rival]) -> bool:
    """Return whether the logs exclude every rival of a finding, as `choose_rivals` returns them."""
    return _doubt(group) < EXCLUDED


def _doubt(group: Sequence[Rival]) -> float:
    """Return the probability of the most probable rival of a finding, which comes first."""
    return max(one.p for one in group[1:])
