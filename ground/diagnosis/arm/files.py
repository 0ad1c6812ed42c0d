"""The files that a diagnosis may leave."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ground.common.files import BadOutput, check_output
from ground.common.requests import BadRequest, check_distinct_files
from ground.diagnosis.arm.patch import NothingToWrite, save_new_params, save_patch
from ground.diagnosis.arm.request import DiagnoseRequest
from ground.diagnosis.page import save_gap_page
from ground.diagnosis.result import Result


@dataclass(frozen=True, slots=True)
class DiagnosisFiles:
    """Where they go; None for none."""

    report: Path | None = None
    patch: Path | None = None
    new_params: Path | None = None


def check_diagnosis_files(files: DiagnosisFiles, params: Path | None, effects: Sequence[str] = ()) -> None:
    """Refuse, before anything is done, what could not be written or is read."""
    read = {f"effect {text}": Path(text) for text in effects if text.endswith(".toml")}
    check_distinct_files(
        {
            **read,
            "params": params,
            "report": files.report,
            "patch": files.patch,
            "new-params": files.new_params,
        }
    )
    try:
        for what, path, suffix in (
            ("report", files.report, ".html"),
            ("patch", files.patch, ".toml"),
            ("new-params", files.new_params, ".toml"),
        ):
            if path is not None:
                check_output(path, (suffix,), what)
    except BadOutput as error:
        raise BadRequest(str(error)) from error


def save_diagnosis(result: Result, request: DiagnoseRequest, files: DiagnosisFiles) -> tuple[str, ...]:
    """Write them; sentences about those that have nothing to say.

    Raises:
        BadRequest: a file cannot be written.
    """
    savers: tuple[tuple[str, Path | None, Callable[[Path], None]], ...] = (
        ("report", files.report, lambda path: save_gap_page(result, path)),
        ("patch", files.patch, lambda path: save_patch(result, path)),
        ("new-params", files.new_params, lambda path: save_new_params(result, request.base, path)),
    )
    not_written = []
    for what, path, save in savers:
        if path is None:
            continue
        try:
            save(path)
        except NothingToWrite as why:
            not_written.append(f"{what} {path}: not written: {why}")
        except BadOutput as error:
            raise BadRequest(str(error)) from error
    return tuple(not_written)
