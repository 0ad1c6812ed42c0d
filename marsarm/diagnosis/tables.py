"""Console output of a diagnosis: four lines, then the notes that a reader has to know of."""

from marsarm.diagnosis.result import DiagnosisResult
from marsarm.diagnosis.sentences import verdict_lines
from simgap.common.console import plain_console, pluralize


def print_diagnosis(result: DiagnosisResult) -> None:
    """Print where the gap is, its cause, how far it shrinks, and what to record next."""
    console = plain_console()
    for label, text in verdict_lines(result):
        console.print(f"{label + ':':<9}{text}")
    if result.notes:
        console.print(f"{pluralize(len(result.notes), 'note')} of the audit are on the page and in --json.")
