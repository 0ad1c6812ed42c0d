"""Results of synthetic cases, one of each verdict, as input for page and document."""

from dataclasses import replace

import numpy as np

from marsarm.diagnosis.closure import (
    build_held_out_model,
    compute_closure,
    compute_held_out_residuals,
    rank_motions,
)
from marsarm.diagnosis.diagnose import Diagnosis, effect_values
from marsarm.diagnosis.normal_equations import form_normal_equations
from marsarm.diagnosis.problem import Residuals
from marsarm.diagnosis.result import DiagnosisResult, ToolError
from tests.marsarm.diagnosis.worlds import found, select_and_diagnose

NOTES = ("motion 3: encoder stale for 1.2 s from 4 s on",)
FLOOR = ("place 1.a: 24 pairs of repeats differ by 1.1",)


def result_of(made, campaign, seed, t=None, extra=None):
    """Diagnose a case of amplitudes t (k,); the same motions, measured again, are held out."""
    rng = np.random.default_rng(seed)
    measured = [made.measured(rng, t, extra, robot=seed) for _ in range(2)]
    said = select_and_diagnose(campaign, Residuals(made.layout, measured[0]), seed=1)
    apart = replace(made.layout, blocks=tuple(f"other {name}" for name in made.layout.blocks))
    held = build_held_out_model(campaign.equations, replace(found(made), layout=apart), campaign.equations.C)
    change = held.sensitivities.change(effect_values(said))
    closing = compute_closure(held, *compute_held_out_residuals(said, held, measured[1], change), seed=1)
    return DiagnosisResult(
        campaign, said, closing, ToolError(0.61, 0.12, 0.02), _motions(made, campaign, said), NOTES, FLOOR
    )


def named(made, campaign):
    """Diagnose one effect without an alias, at six times its limit."""
    one = next(h for h in range(20, 40) if len(campaign.equivalence_class(h)) == 1)
    return result_of(made, campaign, 1, _sized(made, campaign, one, 6.0))


def alike(made, campaign):
    """Diagnose one effect with an alias, at four times its limit."""
    return result_of(made, campaign, 1, _sized(made, campaign, 4, 4.0))


def nothing(made, campaign):
    """Diagnose a case without effect."""
    return result_of(made, campaign, 2)


def unknown(made, campaign):
    """Diagnose structure in one channel that no hypothesis imitates."""
    return result_of(made, campaign, 3, extra=3.0 * _strange(made))


def beside(made, campaign):
    """Diagnose such structure beside an effect: the nearest effect is not named."""
    return result_of(made, campaign, 3, _sized(made, campaign, 4, 8.0), _strange(made))


def undecided(made, campaign):
    """Diagnose an effect slightly above its limit, with alternatives."""
    return result_of(made, campaign, 4, _sized(made, campaign, 21, 1.7))


def _strange(made):
    c, layout = made.layout.condition, made.layout
    return layout.sigma * (c[:, 1] * c[:, 3] + c[:, 4]) * (layout.channel == 6)


def _sized(made, campaign, one, times):
    return np.where(made.owner == one, times * campaign.limits[one].limit, 0.0)


def _motions(made, campaign, said: Diagnosis):
    """Rank two motions for aliased findings; one repeats the campaign."""
    alike_to = [one for finding in said.findings for one in finding.equivalence_class]
    if len(alike_to) < 2:
        return ()
    rng = np.random.default_rng(9)
    kept = found(made)
    other = kept.effect * rng.normal(size=kept.effect.shape)
    ranks = np.bincount(made.owner)
    return rank_motions(
        campaign.equations,
        {one: np.full(ranks[one], 2.0) for one in alike_to},
        {"the same": campaign.equations, "another": form_normal_equations(replace(kept, effect=other))},
    )


def as_of(result, hypothesis, values, verdict="found"):
    """Replace the first finding of a result by a hypothesis with these values."""
    finding = result.diagnosis.findings[0]
    nowhere = np.full(len(values), np.nan)
    changed = replace(finding, values=np.array(values), least=nowhere, most=nowhere)
    names = list(result.model.sensitivities.hypotheses)
    names[finding.hypothesis] = hypothesis
    kept = replace(result.model.sensitivities, hypotheses=tuple(names))
    said = replace(result.diagnosis, findings=(changed,), verdict=verdict)
    return replace(result, model=replace(result.model, sensitivities=kept), diagnosis=said)
