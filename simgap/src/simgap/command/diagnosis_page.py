"""Page and console output of a diagnosis of any robot: the verdict in four lines first."""

from pathlib import Path

from simgap.command.diagnosis import RobotDiagnosis
from simgap.common.console import plain_console
from simgap.common.json_digest import json_sha256
from simgap.common.options import command_text
from simgap.common.page import Origin, save_page
from simgap.report.document import to_document
from simgap.report.page import page_title
from simgap.report.parts import page_parts
from simgap.report.sentences import detail_lines, verdict_lines


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
