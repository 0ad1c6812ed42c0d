"""Many errors as one bound: the paper's combinations, equations 10 to 13, and one from their moments."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array, Flags
from ground.accuracy.moments import SquaredLength

TOTAL, LATERAL, NORMAL, AXIAL = [3, 4, 5], [4, 5], [3], [1, 2]
"""Which components of a screw in tool axes make up the error: of position, across and along the approach, and
of the direction of the approach."""
PARTS: Final = (TOTAL, LATERAL, NORMAL, AXIAL)


@dataclass(frozen=True, slots=True, eq=False)
class Bounds:
    """What the errors at the tool stay within, pose by pose, (n,) each."""

    total_m: Array
    lateral_m: Array
    normal_m: Array
    axial_rad: Array


def bounds(u: Array) -> Bounds:
    """The bounds that follow from components (6, n), each plus or minus."""
    return Bounds(*(np.linalg.norm(u[part], axis=0) for part in PARTS))


def worst_case(u: Array) -> Array:
    """All errors (sources, 6, 7, n) added: components (6, n). Paper equation 10."""
    return np.asarray(u.sum(axis=(0, 2)))


def root_sum_square(u: Array) -> Array:
    """As if all were independent. Paper equation 11."""
    return np.asarray(np.sqrt((u**2).sum(axis=(0, 2))))


def paper_rule(u: Array, at_limit: Flags) -> Array:
    """Frames added source by source; those at their limits added, the others root-sum-squared.

    Paper equations 12 and 13, by the text: the root that is printed covers the added ones too.
    """
    source = u.sum(axis=2)
    return np.asarray(source[at_limit].sum(axis=0) + np.sqrt((source[~at_limit] ** 2).sum(axis=0)))


def shares(u: Array, at_limit: Flags) -> Array:
    """What each source at each frame makes up of the total by the paper's rule, (sources, 7, n) in metres.

    An added source makes up its own components; one under the root its square over the root. Components make
    up the length of the error by their square over it. So the shares add up to the total.
    """
    source = u.sum(axis=2)
    root = np.sqrt((source[~at_limit] ** 2).sum(axis=0))
    weight = np.ones_like(source)
    weight[~at_limit] = _over(source[~at_limit], root)
    total = paper_rule(u, at_limit)[TOTAL]
    along = _over(total, np.linalg.norm(total, axis=0))
    return np.asarray(np.einsum("cn,sc...n,scn->s...n", along, u[:, TOTAL], weight[:, TOTAL]))


def moments_rule(lengths: Sequence[SquaredLength], worst: Bounds, coverage: float) -> Bounds:
    """What the errors stay within, with this probability: PARTS in order, at most the worst case."""
    within = [length.quantile(coverage) for length in lengths]
    most = (getattr(worst, field.name) for field in fields(Bounds))
    return Bounds(*(np.minimum(a, b) for a, b in zip(within, most, strict=True)))


def _over(a: Array, b: Array) -> Array:
    """A / b, or nothing where b is nothing."""
    return np.divide(a, b, out=np.zeros(np.broadcast_shapes(a.shape, b.shape)), where=b > 0)
