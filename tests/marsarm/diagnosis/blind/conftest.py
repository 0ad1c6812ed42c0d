"""Folder of unsolved blind cases of a synthetic robot."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from marsarm.diagnosis.blind_case import SealedTruth, TrueCase, TrueEffect, plan_cases, seal
from marsarm.diagnosis.model import DiagnosisModel
from marsarm.diagnosis.problem import Residuals
from marsarm.diagnosis.result import DiagnosisResult, to_json
from marsarm.diagnosis.sampling import DetectableEffect
from tests.marsarm.diagnosis.worlds import World, found, select_and_diagnose
from validation.blind.case_features import (
    CampaignSensitivities,
    CaseFeatures,
    CaseResiduals,
    read_case_features,
)
from validation.blind.classes import CLASSES_FILE, classes_json
from validation.blind.folder import CAMPAIGN_FOLDER, CASES_FOLDER, case_name, write_json
from validation.blind.solve import Solver

CASES_MADE = 10


@dataclass(frozen=True)
class Folder:
    """Blind cases and their solver."""

    path: Path
    solver: Solver
    truth: SealedTruth


@pytest.fixture
def folder(made: World, campaign: DiagnosisModel, tmp_path: Path) -> Folder:
    """Create cases with effects of the world, and with structure outside its catalogue."""
    rng = np.random.default_rng(5)
    fitted = found(made)
    apart = replace(
        fitted, layout=replace(fitted.layout, blocks=tuple(f"other {b}" for b in fitted.layout.blocks))
    )
    kept = CampaignSensitivities(fitted, apart)
    seen = [
        DetectableEffect(h, one.limit, int(k))
        for h, one, k in zip(made.hypotheses, campaign.limits, campaign.label, strict=True)
    ]
    strange = replace(seen[0].hypothesis, effect="dither")
    plan = plan_cases(CASES_MADE, seen, [replace(seen[0], hypothesis=strange, label=None)], rng)
    cases, rows = [], np.arange(made.layout.size)
    shape = 2.0 * made.layout.sigma * made.layout.condition[:, 1] * (made.layout.channel == 3)
    for number, case in enumerate(plan):
        t = np.zeros(made.owner.size)
        effects = []
        for one in case.effects:
            hypothesis = one.source.hypothesis
            values = {p.name: float(v) for p, v in zip(hypothesis.parameters, one.values, strict=True)}
            effects.append(TrueEffect(hypothesis.effect, hypothesis.place, values, one.times_limit, ""))
            if case.kind != "out-of-catalogue":
                t[made.owner == made.hypotheses.index(hypothesis)] = [
                    v / p.typical for v, p in zip(one.values, hypothesis.parameters, strict=True)
                ]
        extra = shape if case.kind == "out-of-catalogue" else None
        here, there = (CaseResiduals(rows, made.measured(rng, t, extra, robot=number)) for _ in range(2))
        write_json(tmp_path / CASES_FOLDER / case_name(number) / "log", CaseFeatures(here, there).document())
        cases.append(TrueCase(case_name(number), case.kind, tuple(effects), (), 1))
    truth = SealedTruth("aa", tuple(cases))
    seal(tmp_path, truth)
    write_json(tmp_path / CAMPAIGN_FOLDER / CLASSES_FILE, classes_json(campaign))

    def diagnosed(case: Path, _: Path, without: str) -> tuple[dict[str, object], CaseFeatures]:
        features = read_case_features(case / "log")
        model = replace(campaign, left_out_effect=without)
        said = select_and_diagnose(model, Residuals(made.layout, features.fitted.value), 1)
        return to_json(DiagnosisResult(model, said, None, None, (), (), ())), features

    return Folder(tmp_path, Solver(lambda *_: None, lambda _: kept, diagnosed), truth)
