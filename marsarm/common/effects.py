"""Effects of requests: parsed from options, and fitted to an arm."""

from collections.abc import Sequence
from pathlib import Path

from sim.arms import BuiltArm
from sim.effects.effect import Effect, EffectMisfit
from sim.scenario.effects import BadEffect, parse_effect_text, read_effect_file
from simgap.common.errors import BadRequest


def parse_effects(texts: tuple[str, ...], tools: Sequence[str]) -> tuple[Effect, ...]:
    """Parse effects, each a text or a TOML file, for an arm with these tools; BadRequest lists all errors."""
    effects: list[Effect] = []
    problems: list[str] = []
    for text in texts:
        try:
            if text.endswith(".toml"):
                effects += read_effect_file(Path(text), tools)
            else:
                effects.append(parse_effect_text(text, tools))
        except BadEffect as error:
            problems.append(str(error))
    if problems:
        raise BadRequest("\n".join(problems))
    return tuple(effects)


def fit_effects(arm: BuiltArm, effects: tuple[Effect, ...]) -> BuiltArm:
    """Return the arm with those effects that it has before a run; BadRequest if it cannot have one."""
    try:
        return arm.with_effects(effects)
    except EffectMisfit as error:
        raise BadRequest(str(error)) from error
