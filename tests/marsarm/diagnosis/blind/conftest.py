"""Folder of unsolved blind cases of a synthetic robot."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from marsarm.diagnosis.arm.blind_case import DetectableEffect
from marsarm.diagnosis.model import DiagnosisModel
from simgap import to_document
from tests.marsarm.diagnosis.worlds import World, select_and_diagnose
from validation.cases.arm import CAMPAIGN_FOLDER, ArmCases
from validation.cases.arm_features import CLASSES_FILE, classes_json
from validation.cases.arm_truth import SealedEffect, TrueCase, plan_cases
from validation.cases.sealed import CASES_FOLDER, SealedTruth, case_name, seal, write_json

CASES_MADE = 10


@dataclass(frozen=True)
class Folder:
    """Blind cases and their maker."""

    path: Path
    maker: ArmCases
    truth: SealedTruth[TrueCase]


@pytest.fixture
def folder(made: World, campaign: DiagnosisModel, tmp_path: Path) -> Folder:
    """Create cases with effects of the world, and with structure outside its catalogue."""
    rng = np.random.default_rng(5)
    seen = [
        DetectableEffect(h, one.limit, int(k))
        for h, one, k in zip(made.hypotheses, campaign.limits, campaign.label, strict=True)
    ]
    strange = replace(seen[0].hypothesis, effect="dither")
    plan = plan_cases(CASES_MADE, seen, [replace(seen[0], hypothesis=strange, label=None)], rng)
    cases = []
    shape = 2.0 * made.layout.sigma * made.layout.condition[:, 1] * (made.layout.channel == 3)
    for number, case in enumerate(plan):
        t = np.zeros(made.owner.size)
        effects = []
        for one in case.effects:
            hypothesis = one.source.hypothesis
            values = {p.name: float(v) for p, v in zip(hypothesis.parameters, one.values, strict=True)}
            effects.append(SealedEffect(hypothesis.effect, hypothesis.place, values, one.times_limit, ""))
            if case.kind != "out-of-catalogue":
                t[made.owner == made.hypotheses.index(hypothesis)] = [
                    v / p.typical for v, p in zip(one.values, hypothesis.parameters, strict=True)
                ]
        extra = shape if case.kind == "out-of-catalogue" else None
        residuals = made.measured(rng, t, extra, robot=number)
        write_json(tmp_path / CASES_FOLDER / case_name(number) / "log", residuals.tolist())
        cases.append(TrueCase(case_name(number), case.kind, tuple(effects), (), 1))
    truth = SealedTruth("aa", tuple(cases))
    seal(tmp_path, truth)
    write_json(tmp_path / CAMPAIGN_FOLDER / CLASSES_FILE, classes_json(campaign))

    class WorldCases(ArmCases):
        """Cases of the synthetic robot."""

        def prepare(self, *_: object) -> None:
            pass

        def load(self, *_: object) -> None:
            pass

        def diagnose(self, folder: Path, case: Path, without: str = "") -> dict[str, object]:
            residuals = np.array(json.loads((case / "log").read_bytes()))
            model = replace(campaign, left_out_effect=without)
            said = select_and_diagnose(model, residuals, 1)
            return to_document(said)

    return Folder(tmp_path, WorldCases(), truth)
