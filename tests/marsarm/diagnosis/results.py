"""Diagnoses of synthetic cases, one of each verdict, as input for page and document."""

from dataclasses import replace

import numpy as np

from marsarm.diagnosis.diagnose import list_errors
from marsarm.diagnosis.model import alias_cosines
from tests.marsarm.diagnosis.worlds import found, select_and_explain

NOTES = ("motion 3: encoder stale for 1.2 s from 4 s on.",)


def diagnosis_of(made, campaign, seed, t=None, extra=None):
    """Diagnose a case of amplitudes t (k,); the same motions, measured again, are held out."""
    rng = np.random.default_rng(seed)
    measured = [made.measured(rng, t, extra, robot=seed) for _ in range(2)]
    said = select_and_explain(campaign, measured[0], seed=1)
    kept = found(made)
    base = measured[1] - kept.nuisance[:, kept.shared_nuisances] @ said.nuisance
    rows = measured[1], base, base - kept.change(said.values)
    errors = tuple(list_errors(made.layout, rows, made.layout.sigma))
    judged = tuple(f"other {name}" for name in made.layout.blocks)
    return replace(said.diagnosis, robot="world", errors=errors, judged_motions=judged, remarks=NOTES)


def named(made, campaign):
    """Diagnose one effect without an alias, at six times its limit."""
    one = next(h for h in range(20, 40) if len(campaign.equivalence_class(h)) == 1)
    return diagnosis_of(made, campaign, 1, sized(made, campaign, one, 6.0))


def alike(made, campaign):
    """Diagnose one effect with an alias, at four times its limit."""
    return diagnosis_of(made, campaign, 1, sized(made, campaign, 4, 4.0))


def nothing(made, campaign):
    """Diagnose a case without effect."""
    return diagnosis_of(made, campaign, 2)


def unknown(made, campaign):
    """Diagnose structure in one channel that no hypothesis imitates."""
    return diagnosis_of(made, campaign, 3, extra=3.0 * _strange(made))


def beside(made, campaign):
    """Diagnose such structure beside an effect: the nearest effect is not named."""
    return diagnosis_of(made, campaign, 3, sized(made, campaign, 4, 8.0), _strange(made))


def undecided(made, campaign):
    """Diagnose an effect at twice its limit that resembles another as much as effects of two classes can."""
    is_apart = campaign.label[:, None] != campaign.label[None, :]
    cosines = np.where(is_apart, alias_cosines(campaign.equations), 0.0)
    one = int(np.argmax(cosines.max(axis=1)))
    return diagnosis_of(made, campaign, 4, sized(made, campaign, one, 2.0))


def sized(made, campaign, one, times):
    """Return the amplitudes (k,) of a hypothesis at a multiple of its limit."""
    return np.where(made.owner == one, times * campaign.limits[one], 0.0)


def _strange(made):
    c, layout = made.layout.condition, made.layout
    return layout.sigma * (c[:, 1] * c[:, 3] + c[:, 4]) * (layout.channel == 6)


def as_of(diagnosis, hypothesis, amplitudes):
    """Replace the first finding of a diagnosis by a hypothesis with these amplitudes."""
    changed = replace(
        diagnosis.findings[0], place=hypothesis.place, effect=hypothesis.effect, size=tuple(amplitudes)
    )
    return replace(diagnosis, findings=(changed,))
