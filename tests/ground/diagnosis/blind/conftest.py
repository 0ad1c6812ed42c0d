"""A folder of blind cases of a made-up robot: made, not solved."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from ground.diagnosis.blind.classes import FILE, published
from ground.diagnosis.blind.evidence import Features, Kept, Measured, read_features
from ground.diagnosis.blind.folder import CAMPAIGN, CASES, case_name, write_json
from ground.diagnosis.blind.plan import planned
from ground.diagnosis.blind.solve import Solver
from ground.diagnosis.blind.truth import TrueCase, TrueEffect, Truth, seal
from ground.diagnosis.diagnose import diagnose
from ground.diagnosis.drawn import Seen
from ground.diagnosis.layout import Evidence
from ground.diagnosis.ready import Ready
from ground.diagnosis.result import Result
from ground.diagnosis.told import told
from tests.ground.diagnosis.worlds import World, found

CASES_MADE = 10


@dataclass(frozen=True)
class Folder:
    """Cases, and how they are solved."""

    path: Path
    solver: Solver
    truth: Truth


@pytest.fixture
def folder(made: World, campaign: Ready, tmp_path: Path) -> Folder:
    """Cases with effects that the world knows, and with structure that nobody does."""
    rng = np.random.default_rng(5)
    fitted = found(made)
    apart = replace(
        fitted, layout=replace(fitted.layout, blocks=tuple(f"other {b}" for b in fitted.layout.blocks))
    )
    kept, limits = Kept(fitted, apart), [one.limit for one in campaign.limits]
    seen = [Seen(h, lim, int(k)) for h, lim, k in zip(made.hypotheses, limits, campaign.label, strict=True)]
    plan = planned(CASES_MADE, seen, [replace(seen[0], label=None)], rng)
    cases, rows = [], np.arange(made.layout.size)
    shape = 2.0 * made.layout.sigma * made.layout.condition[:, 1] * (made.layout.channel == 3)
    for number, case in enumerate(plan):
        t = np.zeros(made.owner.size)
        effects = []
        for one in case.effects:
            hypothesis = one.seen.hypothesis
            values = {p.name: float(v) for p, v in zip(hypothesis.parameters, one.values, strict=True)}
            effects.append(TrueEffect(hypothesis.effect, hypothesis.place, values, one.times_limit, ""))
            if case.kind != "outside":
                t[made.owner == made.hypotheses.index(hypothesis)] = [
                    v / p.typical for v, p in zip(one.values, hypothesis.parameters, strict=True)
                ]
        extra = shape if case.kind == "outside" else None
        here, there = (Measured(rows, made.measured(rng, t, extra, robot=number)) for _ in range(2))
        write_json(tmp_path / CASES / case_name(number) / "log", Features(here, there).document())
        cases.append(TrueCase(case_name(number), case.kind, tuple(effects), (), 1))
    truth = Truth("aa", tuple(cases))
    seal(tmp_path, truth)
    write_json(tmp_path / CAMPAIGN / FILE, published(made.hypotheses, campaign.label, limits))

    def diagnosed(case: Path, _: Path) -> tuple[dict[str, object], Features]:
        features = read_features(case / "log")
        said = diagnose(campaign, Evidence(made.layout, features.fitted.value), 1)
        return told(Result(campaign, said, None, None, (), (), ())), features

    return Folder(tmp_path, Solver(lambda *_: None, lambda _: kept, diagnosed), truth)
