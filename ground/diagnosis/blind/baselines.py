"""What others say of a blind case, from the same features: kept beside what the diagnosis says."""

from typing import Any

import numpy as np

from ground.diagnosis.baselines import everything_free, gaussian_process, largest_error
from ground.diagnosis.blind.closing import Tried, nothing
from ground.diagnosis.case import reduced
from ground.diagnosis.closure import closed
from ground.diagnosis.plain import finite


def baselines(case: Tried, seed: int) -> dict[str, dict[str, Any]]:
    """The place of the largest error; all effects fitted at once; a Gaussian process on the residual."""
    rest, before = case.left(nothing)
    found, layout = case.fitted.found, case.held.found.layout
    prepared = case.prepared
    most, sizes = everything_free(prepared, reduced(prepared, prepared.whiten(case.fitted.value)))
    named = found.hypotheses[most]
    free = case.closed(lambda of: np.asarray(of.effect @ sizes), seed)
    whitened = case.apart.whiten(before)
    process = closed(case.apart, whitened, whitened - gaussian_process(found.layout, rest, layout), seed)
    return {
        "largest_error": {"place": largest_error(found.layout, rest)},
        "everything_free": {"name": named.effect, "place": named.place, "closure": finite(free.share)},
        "gaussian_process": {"closure": finite(process.share)},
    }
