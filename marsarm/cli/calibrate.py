"""Define the verbs `calibrate` and `calibrate-serial`."""

from marsarm.calibration.request import CalibrateRequest, SerialRequest
from simgap.common.progress import Progress
from simgap.common.verb import VerbResult, verb


@verb
def calibrate_serial(request: SerialRequest, progress: Progress) -> VerbResult:
    """Find the geometry and the joint errors of a serial arm from poses that a laser tracker measured.

    docs/ur10.md describes the files and the results of a real arm. Held-out poses validate the fit. A fitted
    arm is a file like the first, and can be validated on another table.

    Example: marsarm calibrate-serial models/robots/ur10/arm.toml poses.csv models/robots/ur10/series_a.toml
    """
    from marsarm.calibration.serial.execution import calibrate_serial
    from marsarm.calibration.serial.report import save_serial_figure, serial_json, serial_table

    report = calibrate_serial(request, progress)
    problem = None if request.picture is None else save_serial_figure(report, request.picture)
    return VerbResult(serial_json(report, problem), lambda: serial_table(report, problem))


@verb
def calibrate(request: CalibrateRequest, progress: Progress) -> VerbResult:
    """Find the parameters of an arm and their uncertainty from poses that a laser tracker measured.

    In simulation the whole campaign is run: hardstops, every move by flight software, two stand-in turrets,
    level and rolled. Parameters that the poses cannot separate keep their nominal values and are listed.

    Example: marsarm calibrate --arm as-built:7 --out arm7.toml --verify 10 --report calibration.html
    """
    from marsarm.calibration.execution import run_calibration
    from marsarm.calibration.report import (
        calibration_json,
        calibration_table,
        save_calibration_page,
        save_calibration_picture,
    )

    result = run_calibration(request, progress)
    problem = None if request.picture is None else save_calibration_picture(result, request.picture)
    if request.report is not None:
        save_calibration_page(result, request.report)
    return VerbResult(
        {**calibration_json(result), "picture_problem": problem}, lambda: calibration_table(result, problem)
    )
