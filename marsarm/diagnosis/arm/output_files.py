"""Output files of a diagnosis: report page, patch of effects, and new flight parameters."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from fsw.dictionary.params import Params
from marsarm.common.requests import select_arm
from marsarm.diagnosis.arm.case import CaseDiagnosis
from marsarm.diagnosis.arm.request import DiagnoseRequest
from marsarm.diagnosis.arm.simulator import catalogue_effect
from sim.effects.catalogue import effect_name, has_flight_parameter
from sim.effects.effect import Effect
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
    return tuple(
        catalogue_effect(f"{one.place}: {one.effect}", np.array(one.size)) for one in diagnosis.findings
    )


def save_patch(diagnosis: Diagnosis, path: Path) -> None:
    """Write the file that switches on the findings, for --effect and for a scenario.

    NothingToWrite if no effect was found, BadOutput if the file cannot be written.
    """
    comments = [
        "Findings of a diagnosis; switch them on with --effect and the name of this file.",
        *finding_sentences(diagnosis.findings),
    ]
    with atomic_write(path, "patch") as file:
        file.write(effect_file_text(effects_of_findings(diagnosis), comments).encode())


def new_params(base: Params, effects: tuple[Effect, ...]) -> Params:
    """Return flight parameters that include the effects, as far as there are parameters for them.

    NothingToWrite if there is no parameter for any effect, or flight software refuses the values.
    """
    params = base
    for effect in effects:
        params = effect.on_params(params)
    if params == base:
        names = ", ".join(effect_text(effect) for effect in effects)
        raise NothingToWrite(f"there is no flight parameter for {names}")
    try:
        check_params(params, "flight software would not take them")
    except BadParams as error:
        raise NothingToWrite(str(error)) from error
    return params


def save_new_params(diagnosis: Diagnosis, base: Params, drawing: Params, path: Path) -> None:
    """Write the parameter file for --params: all values of `base` and the findings that are not nominal.

    NothingToWrite if there are no new parameters, BadOutput if the file cannot be written.
    """
    effects = effects_of_findings(diagnosis)
    params = new_params(base, effects)
    without_parameter = [
        effect_name(type(effect)) for effect in effects if not has_flight_parameter(type(effect))
    ]
    comments = [
        "Flight parameters with the findings of a diagnosis; all others are nominal.",
        *(f"Effect: {effect_text(effect)}" for effect in effects),
        *(f"There is no flight parameter for {name}." for name in without_parameter),
    ]
    with atomic_write(path, "new-params") as file:
        file.write(params_toml(drawing, params, comments).encode())


def save_diagnosis_files(result: CaseDiagnosis, request: DiagnoseRequest) -> tuple[str, ...]:
    """Write the files of a request; return a line about each, and a reason if it has no content.

    BadOutput if a file cannot be written.
    """

    def save_page(path: Path) -> None:
        digests = {**result.digests, "result": json_sha256(to_document(result.diagnosis))}
        origin = Origin(command_text("marsarm diagnose", request), digests)
        save_diagnosis_page(result.diagnosis, result.traces, path, origin)

    def save_params(path: Path) -> None:
        assert result.params is not None
        save_new_params(result.diagnosis, result.params, select_arm(request.arm, None).model.params, path)

    savers: tuple[tuple[str, Path | None, Callable[[Path], None]], ...] = (
        ("report", request.report, save_page),
        ("patch", request.patch, lambda path: save_patch(result.diagnosis, path)),
        ("new-params", request.new_params, save_params),
    )
    lines: list[str] = []
    for what, path, save in savers:
        if path is None:
            continue
        try:
            save(path)
            lines += file_lines({what: path})
        except NothingToWrite as why:
            lines.append(f"{what} {path}: not written: {why}")
    return tuple(lines)
