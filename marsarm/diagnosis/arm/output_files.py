"""Output files of a diagnosis: report page, patch of effects, and new flight parameters."""

import numpy as np

from fsw.dictionary.params import Params
from marsarm.common.requests import select_arm
from marsarm.diagnosis.arm.case import CaseDiagnosis
from marsarm.diagnosis.arm.request import DiagnoseRequest
from marsarm.diagnosis.problem import Hypothesis
from sim.effects.catalogue import effect_name, has_flight_parameter
from sim.effects.effect import Effect, params_with_effects
from sim.params import BadParams, check_params, params_toml
from sim.scenario.effects import effect_file_text, effect_text
from simgap import Diagnosis, to_document
from simgap.common.files import atomic_write, json_sha256
from simgap.common.options import command_text
from simgap.common.page import Origin
from simgap.common.report import file_lines
from simgap.report.details import finding_sentences
from simgap.report.page import save_diagnosis_page


class NothingToWrite(Exception):
    """No content for a file; the message says why."""


def effects_of_findings(diagnosis: Diagnosis) -> tuple[Effect, ...]:
    """Return the effects of a diagnosis with their fitted values; NothingToWrite if there is none."""
    if not diagnosis.findings:
        raise NothingToWrite("no effect was found, so there is none to switch on")
    pairs = zip(diagnosis.effects, diagnosis.sizes, strict=True)
    return tuple(one.switch_on(np.array(size)) for one, size in pairs if isinstance(one, Hypothesis))


def patch_text(diagnosis: Diagnosis) -> str:
    """Return the file that switches on the findings, for --effect and for a scenario.

    NothingToWrite if no effect was found.
    """
    comments = [
        "Findings of a diagnosis; switch them on with --effect and the name of this file.",
        *finding_sentences(diagnosis.findings),
    ]
    return effect_file_text(effects_of_findings(diagnosis), comments)


def new_params(base: Params, effects: tuple[Effect, ...]) -> Params:
    """Return flight parameters that include the effects, as far as there are parameters for them.

    NothingToWrite if there is no parameter for any effect, or flight software refuses the values.
    """
    params = params_with_effects(effects, base)
    if params == base:
        names = ", ".join(effect_text(effect) for effect in effects)
        raise NothingToWrite(f"there is no flight parameter for {names}")
    try:
        check_params(params, "flight software would not take them")
    except BadParams as error:
        raise NothingToWrite(str(error)) from error
    return params


def params_text(diagnosis: Diagnosis, base: Params, drawing: Params) -> str:
    """Return the parameter file for --params: all values of `base` and the findings that are not nominal.

    NothingToWrite if there are no new parameters.
    """
    effects = effects_of_findings(diagnosis)
    params, kinds = new_params(base, effects), [type(effect) for effect in effects]
    unknown = [effect_name(kind) for kind in kinds if not has_flight_parameter(kind)]
    comments = [
        "Flight parameters with the findings of a diagnosis; all others are nominal.",
        *(f"Effect: {effect_text(effect)}" for effect in effects),
        *(f"There is no flight parameter for {name}." for name in unknown),
    ]
    return params_toml(drawing, params, comments)


def save_diagnosis_files(result: CaseDiagnosis, request: DiagnoseRequest) -> tuple[str, ...]:
    """Write the files of a request; return a line about each, and a reason if it has no content.

    BadOutput if a file cannot be written.
    """
    diagnosis, base, drawing = result.diagnosis, result.params, select_arm(request.arm, None).model.params
    lines: list[str] = []
    if request.report is not None:
        digests = {**result.digests, "result": json_sha256(to_document(diagnosis))}
        origin = Origin(command_text("marsarm diagnose", request), digests)
        save_diagnosis_page(diagnosis, result.traces, request.report, origin)
        lines += file_lines({"report": request.report})
    for what, path in (("patch", request.patch), ("new-params", request.new_params)):
        if path is None:
            continue
        try:
            is_patch = what == "patch"
            text = patch_text(diagnosis) if is_patch else params_text(diagnosis, base or drawing, drawing)
        except NothingToWrite as why:
            lines.append(f"{what} {path}: not written: {why}")
            continue
        with atomic_write(path, what) as file:
            file.write(text.encode())
        lines += file_lines({what: path})
    return tuple(lines)
