"""The arm's campaign and cases in the terms of the robot-agnostic part."""

import json
from functools import cache
from pathlib import Path

import numpy as np

from ground.gap.arm.campaign import compared, measured_values, predicted_values
from ground.gap.arm.logs import NotForDiagnosis, recording_in
from ground.gap.arm.sensitivities import keys_of, keys_path
from ground.gap.arm.simulator import BRIEFLY
from ground.gap.blind.evidence import Kept, Measured
from ground.gap.sensitivity import load
from ground.request import BadRequest
from sim.diagnosis.campaign import HELD_OUT
from sim.params import nominal_params


@cache
def kept_campaign(folder: Path) -> Kept:
    """Once in each process; BadRequest if there are no sensitivities."""
    path = _sensitivities(folder)
    sessions = [key.split("/")[0] for key in _keys(path)]
    return Kept(load(path), np.isin(sessions, HELD_OUT))


def measured_case(case: Path, campaign: Path) -> Measured:
    """What a case's logs say less what the nominal simulator predicts under the same drive.

    Raises:
        NotForDiagnosis: it has no log, or one that cannot be compared.
    """
    base = nominal_params()
    logs = sorted(case.glob("*.mcap"))
    if not logs:
        raise NotForDiagnosis(f"{case}: holds no log")
    there = compared([recording_in(path) for path in logs], base)
    value = measured_values(there) - predicted_values(there, base, (), BRIEFLY)
    row_of = {key: row for row, key in enumerate(_keys(_sensitivities(campaign)))}
    rows = np.array([row_of.get(key, -1) for key in keys_of(there)], np.intp)
    known = rows >= 0
    return Measured(rows[known], value[known])


def _sensitivities(folder: Path) -> Path:
    found = sorted(folder.glob("sensitivities-*.npz"))
    if len(found) != 1:
        raise BadRequest(
            f"{folder}: holds {len(found)} files of sensitivities; make the cases, or remove what is old"
        )
    return found[0]


@cache
def _keys(sensitivities: Path) -> tuple[str, ...]:
    return tuple(json.loads(keys_path(sensitivities).read_bytes()))
