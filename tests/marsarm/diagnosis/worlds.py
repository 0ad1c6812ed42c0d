"""Synthetic linear robots: hypotheses (some aliased), nuisances, and data of known truth."""

from dataclasses import dataclass

import numpy as np

from marsarm.diagnosis.diagnose import diagnose
from marsarm.diagnosis.model import build_full_whitener
from marsarm.diagnosis.problem import FeatureLayout, Hypothesis, Nuisance, Parameter, Sensitivities
from marsarm.diagnosis.selection import select_simulated
from simgap.effects.effect import Family

REGIMES = ("rest", "slow", "reversal")


@dataclass(frozen=True, slots=True, eq=False)
class World(Sensitivities):
    """Simulator that is what its sensitivities say, also beyond their reach."""

    def simulate(self, settings):
        t = np.zeros(self.owner.size)
        for hypothesis, departures in settings.items():
            t[self.owner == self.hypotheses.index(hypothesis)] = departures
        return self.effect @ t + self.curve @ t**2

    def measured(self, rng, t=None, robot=None):
        """Return the residual of a case: amplitudes t (k,) in typical sizes, random nuisances, and noise.

        A robot, by number, has the same nuisances in every campaign.
        """
        layout, same = self.layout, rng if robot is None else np.random.default_rng(robot)
        block_of = np.cumsum(layout.block != np.roll(layout.block, 1)) - 1
        value = layout.sigma * rng.standard_normal(layout.size)
        if t is not None:
            value += self.effect @ t + self.curve @ t**2
        for index, nuisance in enumerate(self.nuisances):
            each = nuisance.random_per_block
            draw = rng.standard_normal(block_of[-1] + 1) if each else same.standard_normal(1)
            value += self.nuisance[:, index] * nuisance.sigma * np.resize(draw, block_of[-1] + 1)[block_of]
        return value


def world(seed=0, m=1200, effects=8, places=5, nuisances=12, blocks=15, alike=4, two=2, scatter=2, bent=0.0):
    """Build places with three channels each; effects are smooth in the conditions.

    The last `alike` effects are nearly copies of others; `two` effects have two parameters. A share `bent` of
    each effect grows with the square of its amplitude.
    """
    rng = np.random.default_rng(seed)
    block = np.sort(np.arange(m) % blocks)
    place = rng.integers(places, size=m)
    channel = 3 * place + rng.integers(3, size=m)
    phase = np.linspace(0.0, 40.0, m)
    condition = np.column_stack([
        rng.normal(size=blocks)[block], np.sin(0.7 * phase + place), np.sign(np.sin(2.3 * phase)),
        np.abs(np.cos(1.1 * phase)), np.sin(phase + place), np.cos(phase + place),
    ])  # fmt: skip
    names = [tuple(f"{what} {i}" for i in range(n)) for what, n in (("motion", blocks), ("place", places))]
    channels = tuple(f"{names[1][c // 3]}.{'abc'[c % 3]}" for c in range(3 * places))
    sigma = 10.0 ** rng.uniform(-4.0, 1.0, size=3 * places)[channel]
    layout = FeatureLayout(
        sigma, np.array(names[0])[block], np.array(channels)[channel], np.full(m, "u"),
        np.array(REGIMES)[block % 3], condition, np.arange(m) / 4.0, np.arange(m).astype(str),
    )  # fmt: skip
    basis = _basis(condition, channel)
    shapes = [
        rng.normal(size=(basis.shape[1], 2)) * (rng.random((basis.shape[1], 1)) < 0.25)
        for _ in range(effects)
    ]
    for i in range(alike):
        shapes[effects - 1 - i] = shapes[i] + 0.05 * shapes[effects - 1 - i]
    hypotheses, columns, owner = [], [], []
    for e in range(effects):
        k = 2 if two <= e < 2 * two else 1
        for p in range(places):
            near = np.where(place == p, 1.0, np.where(np.abs(place - p) == 1, 0.2, 0.0))
            parameters = tuple(Parameter(f"size {i}", "u", -1e3, 1e3, 0.5 + i, 0.0) for i in range(k))
            family = list(Family)[e % 4]
            hypotheses.append(Hypothesis(f"effect {e}", names[1][p], parameters, family, names[1][p]))
            columns += list((sigma[:, None] * near[:, None] * (basis @ shapes[e])[:, :k]).T)
            owner += [len(hypotheses) - 1] * k
    N = sigma[:, None] * (basis @ rng.normal(size=(basis.shape[1], nuisances))) * 0.2
    N *= rng.random((places, nuisances))[place] < 0.4
    uncertain = tuple(Nuisance(f"n{i}", "u", 0.1 * (1 + i % 7), i < scatter) for i in range(nuisances))
    effect = np.array(columns).T
    return World(
        layout, tuple(hypotheses), uncertain, effect, bent * effect, np.ones(len(owner)), np.array(owner), N
    )


def select_and_diagnose(model, value, simulate=None):
    """Select effects and diagnose; by default large effects are extrapolated."""
    made = model.sensitivities
    found = select_simulated(model, build_full_whitener(made), value, 1, simulate or made.change)
    return diagnose(model, value, found).diagnosis


def sized(made, campaign, one, times):
    """Return the amplitudes (k,) of a hypothesis at a multiple of its limit."""
    return np.where(made.owner == one, times * campaign.limits[one], 0.0)


def strange(made, channel="place 2.a"):
    """Return structure (m,) in one channel that no hypothesis imitates."""
    c, layout = made.layout.condition, made.layout
    return layout.sigma * (c[:, 1] * c[:, 3] + c[:, 4]) * (layout.channel == channel)


def indices(model, diagnosis):
    """Return the index of the hypothesis of each finding."""
    return [model.sensitivities.index(f"{one.place}: {one.effect}") for one in diagnosis.findings]


def _basis(c, channel):
    """Return smooth functions (m, n) of the conditions, different in each kind of channel."""
    pure = [np.ones(len(c)), *c.T, c[:, 1] * c[:, 2], c[:, 0] * c[:, 2], c[:, 1] * c[:, 4], c[:, 3] * c[:, 5]]
    return np.column_stack([one * (channel % 3 == kind) for one in pure for kind in range(3)])
