"""Define the verb `calibrate-serial`."""

from marsarm.calibration.request import SerialRequest
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
