"""Define the verb `calibrate`."""

from marsarm.calibration.request import CalibrateRequest
from simgap.common.progress import Progress
from simgap.common.verb import VerbResult, verb


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
