"""Diagnosis of a serial arm by poses that a tracker measured, its document and the arms that it writes."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simgap.command.request import ARM_FILE, CALIBRATED_FILE, DiagnoseRequest
from simgap.common.errors import BadRequest, RobotError
from simgap.common.files import atomic_write, check_distinct_files, digest_files
from simgap.common.progress import Progress
from simgap.common.report import ReportTable, to_json
from simgap.files.robot_file import SerialFile
from simgap.result import Diagnosis
from simgap.serial_arm.calibrate import JointTerms, held_out_ratio, joint_errors
from simgap.serial_arm.effects import patch_arm
from simgap.serial_arm.files import arm_to_toml, read_arm, read_series
from simgap.serial_arm.fit import assess_identifiability
from simgap.serial_arm.model import GEOMETRY, TERMS, SerialArm
from simgap.serial_arm.nested_models import NestedModel
from simgap.serial_arm.tracker import TrackerFit, describe_tracker, fit_tracker


def parse_terms(text: str) -> tuple[str, ...]:
    """Return the terms that a text names, in the order of TERMS; BadRequest if a word is not known."""
    if text in ("all", "none"):
        return TERMS if text == "all" else ()
    words = [word.strip() for word in text.split(",")]
    wrong = next((word for word in words if word not in TERMS), None)
    if wrong in ("all", "none"):
        raise BadRequest(f"terms: {text!r}: all and none stand alone")
    if wrong is not None:
        raise BadRequest(f"terms: {wrong!r:.60} is not known; there are {', '.join(TERMS)}, all and none")
    return tuple(term for term in TERMS if term in words)


@dataclass(frozen=True, slots=True)
class PoseDiagnosis:
    """A diagnosis by poses, with what its files need."""

    diagnosis: Diagnosis
    fitted: TrackerFit
    patched: SerialArm
    """Arm with what was named."""
    digests: dict[str, str]
    """SHA-256 of the files that were read."""

    def document(self) -> dict[str, Any]:
        """Convert the calibration to a JSON document in metres and radians."""
        fitted = self.fitted
        last, fit, test = fitted.models[-1], fitted.found.fit, fitted.temperature
        seen = assess_identifiability(fit.parameters, fit.at, fit.used)
        return {
            "fitted_poses": fitted.found.model.series.count,
            "terms": list(last.terms),
            "models": [_model_json(one) for one in fitted.models],
            "held_out_rms_m": last.fresh.rms_m,
            "held_out_rms_rad": last.fresh.rms_rad,
            "held_out_over_expected": held_out_ratio(fitted.found, fitted.fresh),
            "fit": {
                "parameters": len(fit.parameters),
                "rank": seen.rank,
                "condition": seen.condition if seen.rank else None,
                "converged": fit.converged,
                "iterations": fit.iterations,
                "sigma0": fit.sigma0,
                "outlier_rows": list(fitted.found.outliers),
                "unidentifiable": to_json(seen.unidentifiable_groups()),
            },
            "joints": to_json(joint_errors(fitted.found)),
            "temperature": None
            if test is None
            else to_json(test) | {"explains": "something" if test.explains else "nothing"},
        }

    def parts(self) -> list[str | ReportTable]:
        """Show the gain of each term, the errors of the joints, and the noise."""
        fitted, rows = self.fitted, []
        for k, one in enumerate(fitted.models):
            gain = [one.gain_m, one.gain_sigma_m] if k else [None, None]
            lengths_m = [
                one.fitted.rms_m,
                one.held_out.rms_m,
                *gain,
                one.fresh.rms_m,
                one.fresh.position_m.max(),
            ]
            cells = ("" if length is None else f"{length * 1e3:.3f}" for length in lengths_m)
            rows.append((f"+ {one.terms[-1]}" if k else "base, target", *cells))
        poses = f"{fitted.found.model.series.count} poses fitted, {fitted.fresh.count} held out"
        head = ("with", "fitted", "validated", "less by", "+-", "held out", "largest")
        parts: list[str | ReportTable] = [ReportTable(head, rows, f"Position error, rms [mm]; {poses}")]
        if set(fitted.models[-1].terms) - {GEOMETRY}:
            head = ("joint", "compliance", "+-", "hysteresis", "+-", "periodic", "largest")
            rows = [_joint_cells(one) for one in joint_errors(fitted.found)]
            parts.append(ReportTable(head, rows, "Joint errors: urad/Nm, urad, mrad, mrad"))
        fit = fitted.found.fit
        return [*parts, f"{len(fit.parameters)} parameters; noise is {fit.sigma0:.2f} of what the file says"]

    def write(self, folder: Path) -> None:
        """Write the arm with what was named, and that with all that was fitted."""
        folder.mkdir(exist_ok=True)
        arms = {ARM_FILE: (self.patched, "named"), CALIBRATED_FILE: (self.fitted.found.arm, "fitted")}
        for name, (arm, what) in arms.items():
            about = [
                f"{self.diagnosis.robot}, with links and effects as {what} by a diagnosis.",
                *(f"{one} sha256 {digest}" for one, digest in self.digests.items()),
            ]
            with atomic_write(folder / name, "patch") as file:
                file.write(arm_to_toml(arm, about).encode())


def diagnose_poses(request: DiagnoseRequest, file: SerialFile, progress: Progress) -> PoseDiagnosis:
    """Diagnose an arm by poses; BadRequest or RobotError if anything given is wrong."""
    terms = parse_terms(request.terms)
    for name in ("split", "held-out", "effects", "start"):
        if getattr(request, name.replace("-", "_")):
            why = "is for logs; of poses, the earlier ones are fitted and the later ones judge"
            raise BadRequest(f"{name}: {why}")
    if len(request.logs) != 1:
        raise BadRequest(f"logs: {len(request.logs)} tables of poses; give one, for one pose of the tracker")
    folder, (table,) = request.robot.parent, request.logs
    if table.name not in file.poses:
        known = ", ".join(file.poses)
        raise RobotError(f"{request.robot}: poses: has no mapping for {table.name}; has {known}")
    path, mapping = folder / file.serial_arm, folder / file.poses[table.name]
    if request.patch is not None:
        for name in (ARM_FILE, CALIBRATED_FILE):
            check_distinct_files({"serial_arm": path, "patch": request.patch / name})
    arm = read_arm(path)
    series = read_series(arm, table, mapping)
    digests = digest_files({"robot": [request.robot, path, mapping], "log": [table]})
    fitted = fit_tracker(arm, series, terms=terms, fit_share=request.fit_share, progress=progress)
    result = describe_tracker(fitted)
    return PoseDiagnosis(result, fitted, patch_arm(arm, result.effects, result.sizes), digests)


def _model_json(model: NestedModel) -> dict[str, Any]:
    is_first = model.gain_sigma_m == 0.0
    return {
        "terms": list(model.terms),
        "fitted_rms_m": model.fitted.rms_m,
        "cross_validated_rms_m": model.held_out.rms_m,
        "gain_m": None if is_first else model.gain_m,
        "gain_sigma_m": None if is_first else model.gain_sigma_m,
        "significant": model.is_significant,
        "held_out_rms_m": model.fresh.rms_m,
        "held_out_max_m": float(model.fresh.position_m.max()),
        "held_out_rms_rad": model.fresh.rms_rad,
    }


def _joint_cells(one: JointTerms) -> tuple[str, ...]:
    micro = (one.compliance_rad_per_Nm, one.compliance_sigma, one.hysteresis_rad, one.hysteresis_sigma)
    milli = (one.periodic_rms_rad, one.periodic_peak_rad)
    return one.name, *(f"{1e6 * value:.1f}" for value in micro), *(f"{1e3 * value:.2f}" for value in milli)
