"""Diagnosis model: all that is fixed, and can be published, before a case is measured.

It holds the normal equations of the linear model, and the equivalence classes and the detection limits of the
hypotheses.

The whitened model is y = N v + S a + e with e of unit covariance. The nuisances v are in units of their
sigma, so that their prior has unit covariance too. They are eliminated by the Schur complement:

    R = S'S - S'N (N'N + 1)^-1 N'S

Shapes use m features, q shared nuisances and k columns of h hypotheses. In all functions, `rows` are indices
of features, `y` are whitened features, (m,), and `label` are the equivalence classes of the hypotheses, (h,).
"""

from collections.abc import Collection
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import brentq
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.stats import chi2, ncx2

from fsw.kinematics.transforms import Array, Flags
from marsarm.diagnosis.problem import Ints, Sensitivities
from simgap.selection.chance import FALSE_ALARM

ALIAS_COSINE: Final = 0.99
"""Absolute cosine of projected sensitivities above which two hypotheses cannot be distinguished."""
RANK_TOLERANCE: Final = 1e-9
"""Eigenvalues below this share of the greatest count as 0."""
KINDS_OF_TEST: Final = 2
"""Effects and the test of what remains share the probability of a false alarm."""
POWER: Final = 0.9
"""Probability that an effect at the detection limit passes the test."""
ABSORBED_SHARE: Final = 1e-6
"""A column counts as not identifiable if the nuisances leave less than this share of its square."""

BlockCovariance = tuple[Ints, Array, Array]
"""Low-rank covariance by nuisances: of the features of a block, if random per block, or of all.

Indices of the features, shape (n,), orthonormal directions, (n, s), and the share by which whitening reduces
each of them, (s,).
"""


@dataclass(frozen=True, slots=True, eq=False)
class Whitener:
    """Linear map that makes the noise of the features independent and of unit variance."""

    sigma: Array
    scatter: tuple[BlockCovariance, ...]

    def __call__(self, X: Array) -> Array:
        """Whiten features in the units of their channels, shape (m,) or (m, n)."""
        Z = (X.T / self.sigma).T
        for rows, U, shrinkage in self.scatter:
            Z[rows] -= (U * shrinkage) @ (U.T @ Z[rows])
        return Z


def build_whitener(sensitivities: Sensitivities) -> Whitener:
    """Build the whitener from the noise floor and the nuisances that are random per block."""
    layout = sensitivities.layout
    drawn = [one.random_per_block for one in sensitivities.nuisances]
    L = sensitivities.nuisance[:, drawn] * sensitivities.sigma[drawn] / layout.sigma[:, None]
    blocks = [np.flatnonzero(layout.block == block) for block in dict.fromkeys(layout.block.tolist())]
    return Whitener(layout.sigma, tuple(_block_covariance(rows, L[rows]) for rows in blocks if L[rows].any()))


def build_full_whitener(sensitivities: Sensitivities) -> Whitener:
    """Build the whitener from the noise floor and all nuisances with their priors."""
    first = build_whitener(sensitivities)
    N = whiten_nuisances(sensitivities, first)
    shared = _block_covariance(np.arange(len(N)), N)
    return Whitener(first.sigma, (*first.scatter, shared))


def _block_covariance(rows: Ints, L: Array) -> BlockCovariance:
    """Return the covariance L L' of some features beside unit noise, L (n, s)."""
    U, S, _ = np.linalg.svd(L, full_matrices=False)
    return rows, U, 1.0 - 1.0 / np.sqrt(1.0 + S**2)


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """Normal equations of a campaign; they do not depend on measured data.

    Columns are scaled so that an amplitude a of 1 is one standard error, with nuisances free.
    """

    owner: Ints
    """Index of the hypothesis that each column belongs to, shape (k,)."""
    whiten: Whitener
    N: Array
    """Whitened nuisances, shape (m, q)."""
    S: Array
    """Whitened columns, shape (m, k)."""
    R: Array
    """Information of the columns with nuisances eliminated, shape (k, k)."""
    scale: Array
    """Standard errors per typical size, shape (k,); 0 for a column that is not identifiable."""

    @property
    def q(self) -> int:
        """Number of shared nuisances."""
        return int(self.N.shape[1])

    @property
    def identifiable(self) -> Flags:
        """Flags of the hypotheses whose columns are all identifiable beside the nuisances, shape (h,)."""
        hidden = np.zeros(self.owner[-1] + 1, bool)
        hidden[self.owner[self.scale == 0.0]] = True
        return ~hidden


def form_normal_equations(sensitivities: Sensitivities) -> NormalEquations:
    """Form the normal equations of all hypotheses; columns that are not identifiable become 0."""
    whiten = build_whitener(sensitivities)
    N, S = whiten_nuisances(sensitivities, whiten), whiten(sensitivities.effect)
    across = N.T @ S
    R = S.T @ S - across.T @ np.linalg.solve(N.T @ N + np.eye(N.shape[1]), across)
    information = np.diagonal(R)
    is_seen = information > ABSORBED_SHARE * np.sum(S**2, axis=0)
    scale = np.sqrt(np.where(is_seen, information, 0.0))
    by = np.where(is_seen, 1.0 / np.where(is_seen, scale, 1.0), 0.0)
    R = (R + R.T) / 2.0 * np.outer(by, by)
    return NormalEquations(sensitivities.owner, whiten, N, S * by, R, scale)


def whiten_nuisances(sensitivities: Sensitivities, whiten: Whitener) -> Array:
    """Whiten the columns of the shared nuisances, in units of their sigma, (m, q)."""
    shared = sensitivities.shared_nuisances
    return whiten(sensitivities.nuisance[:, shared]) * sensitivities.sigma[shared]


@dataclass(frozen=True, slots=True, eq=False)
class LinearFit:
    """Nuisances and chosen columns, fitted together."""

    A: Array
    """Fitted columns: whitened nuisances, then the chosen ones, shape (m, n)."""
    theta: Array
    """Fitted values, shape (n,): nuisances in sigmas, amplitudes in standard errors."""
    covariance: Array
    """Posterior covariance, shape (n, n)."""


def fit_linear(equations: NormalEquations, y: Array, chosen: Collection[int]) -> LinearFit:
    """Fit nuisances and chosen hypotheses by maximum posterior; singular combinations stay at 0."""
    A = np.hstack([equations.N, equations.S[:, np.isin(equations.owner, list(chosen))]])
    prior = np.where(np.arange(A.shape[1]) < equations.q, 1.0, 0.0)
    covariance = np.linalg.pinv(A.T @ A + np.diag(prior), rcond=1e-13, hermitian=True)
    return LinearFit(A, covariance @ (A.T @ y), covariance)


@dataclass(frozen=True, slots=True, eq=False)
class DiagnosisModel:
    """Normal equations, equivalence classes and detection limits of a campaign."""

    sensitivities: Sensitivities
    equations: NormalEquations
    label: Ints
    """Equivalence class of every hypothesis, shape (h,)."""
    limits: Array
    """Detection limit of every hypothesis in typical sizes, its parameters departing together, shape (h,);
    infinite if it is not identifiable."""
    family_wise_limits: Array
    """The same in the selection from all hypotheses, whose false alarms together have 5 %, shape (h,)."""
    left_out_effect: str = ""
    """Effect that does not compete, to see what takes the place of one that no catalogue has; "" for none."""

    @property
    def left_out(self) -> frozenset[int]:
        """Hypotheses of the left-out effect at all places, and those that these motions show alike."""
        named = zip(self.label, self.sensitivities.hypotheses, strict=True)
        gone = {int(k) for k, one in named if one.name == self.left_out_effect}
        return frozenset(k for k, label in enumerate(self.label) if int(label) in gone)

    def equivalence_class(self, hypothesis: int) -> tuple[int, ...]:
        """Return the hypotheses of the same equivalence class, itself included."""
        return tuple(int(one) for one in (self.label == self.label[hypothesis]).nonzero()[0])


def build_model(sensitivities: Sensitivities, left_out_effect: str = "") -> DiagnosisModel:
    """Build the diagnosis model from the sensitivities of a campaign."""
    equations = form_normal_equations(sensitivities)
    label = equivalence_classes(equations)
    return DiagnosisModel(
        sensitivities, equations, label, *detection_limits(equations, label), left_out_effect
    )


def alias_cosines(equations: NormalEquations) -> Array:
    """Compute the cosine (h, h) of the largest angle between the columns of every two hypotheses.

    The metric is R, with nuisances eliminated. The cosine is 0 between hypotheses with different numbers of
    columns: one is at most a special case of the other, and parsimony decides. It is 0 for a hypothesis that
    is not identifiable.
    """
    of = [np.flatnonzero(equations.owner == h) for h in range(equations.owner[-1] + 1)]
    roots = [_inverse_root(equations.R[np.ix_(at, at)]) for at in of]
    whole = block_diag(*roots)
    cosines = whole.T @ equations.R @ whole
    ranks = np.array([at.size for at in of])
    result = np.zeros((len(of), len(of)))
    for k in np.unique(ranks):
        chosen = np.flatnonzero(ranks == k)
        at = np.array([of[h] for h in chosen])
        pairs = cosines[at[:, None, :, None], at[None, :, None, :]]
        result[np.ix_(chosen, chosen)] = np.linalg.svd(pairs, compute_uv=False)[..., -1]
    result *= np.outer(equations.identifiable, equations.identifiable)
    np.fill_diagonal(result, 1.0)
    return result


def equivalence_classes(equations: NormalEquations) -> Ints:
    """Return the equivalence class of every hypothesis, shape (h,), numbered by its first member.

    Classes are connected components: two members may have a smaller cosine than ALIAS_COSINE.
    """
    _, label = connected_components(csr_array(alias_cosines(equations) > ALIAS_COSINE), directed=False)
    return np.asarray(label, np.intp)


def _inverse_root(R: Array) -> Array:
    """Return X (k, k) with X'R X = 1 on the range of R."""
    s, V = np.linalg.eigh(R)
    positive = s > RANK_TOLERANCE * max(s[-1], 1.0)
    return np.asarray(V * np.where(positive, 1.0 / np.sqrt(np.where(positive, s, 1.0)), 0.0))


@cache
def noncentrality(k: int, false_alarm: float = FALSE_ALARM) -> float:
    """Compute the noncentrality of a chi-square of k degrees of freedom for 90 % power and a false alarm."""
    beyond = chi2.isf(false_alarm, k)
    return float(brentq(lambda n: ncx2.sf(beyond, k, n) - POWER, 1e-6, 1e3))


def detection_limits(equations: NormalEquations, label: Ints) -> tuple[Array, Array]:
    """Compute the size (h,) that a likelihood-ratio test finds with 90 % power: alone, and in the selection.

    The test against no effect has 5 % false alarm, with nuisances free. Its statistic is a noncentral
    chi-square of k degrees with noncentrality a'R a for amplitudes a. Typical sizes give a = limit * scale.
    In the selection from all hypotheses, each class has its share of half of that (Bonferroni); the test of
    what remains has the other half.
    """
    n_classes = np.unique(label[equations.identifiable]).size
    false_alarms = FALSE_ALARM, FALSE_ALARM / KINDS_OF_TEST / max(n_classes, 1)
    alone, family_wise = np.full((2, label.size), np.inf)
    for index in np.flatnonzero(equations.identifiable):
        at = np.flatnonzero(equations.owner == index)
        information = float(equations.scale[at] @ equations.R[np.ix_(at, at)] @ equations.scale[at])
        if information > 0.0:
            needed = [noncentrality(at.size, by) for by in false_alarms]
            alone[index], family_wise[index] = np.sqrt(np.array(needed) / information)
    return alone, family_wise
