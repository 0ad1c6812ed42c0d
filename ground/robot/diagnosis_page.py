"""Page and console output of a diagnosis of any robot: the verdict in four lines first."""

from pathlib import Path

from diagnosis.report.document import to_document
from diagnosis.report.page import page_title
from diagnosis.report.parts import page_parts
from diagnosis.report.sentences import detail_lines, verdict_lines
from ground.common.command_text import command_text
from ground.common.json_digest import json_sha256
from ground.render.console import plain_console
from ground.render.page import Origin, save_page
from ground.robot.diagnosis import RobotDiagnosis


def save_diagnosis_page(made: RobotDiagnosis, path: Path) -> None:
    """Write the page.

    Raises:
        BadOutput: the file cannot be written.
    """
    result = made.diagnosis
    origin = Origin(
        command_text("robot diagnose", made.request),
        {**made.digests, "result": json_sha256(to_document(result))},
    )
    verdict = "\n".join(verdict_lines(result))
    save_page(page_title(result), verdict, (), origin, page_parts(result, made.traces), path)


def print_diagnosis(made: RobotDiagnosis) -> None:
    """Print the four lines, then the details."""
    console = plain_console()
    for line in verdict_lines(made.diagnosis):
        console.print(line)
    details = detail_lines(made.diagnosis)
    if details:
        console.print()
    for line in details:
        console.print(line)
