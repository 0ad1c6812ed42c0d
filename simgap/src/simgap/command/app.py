"""Command line `simgap`: its verbs."""

from simgap.command.request import CheckRequest, CompareRequest, DiagnoseRequest, InitRequest, NextRequest
from simgap.common.app import make_app, run_app
from simgap.common.progress import Progress
from simgap.common.verb import VerbResult, shown, verb

app = make_app("simgap", "Find why a robot and its MuJoCo model differ: where, by which effect, and how far.")


@app.command()
@verb
def init(request: InitRequest, progress: Progress) -> VerbResult:
    """Write a first robot file from a model and logs.

    It finds which column is which joint, by names, order and units. Each guess stands in the file with its
    reason, each doubt as a question. docs/simgap.md says what it looks at.

    Example: simgap init model.xml log.csv --out robot.toml
    """
    from simgap.command.first_file import first_file_parts, write_first_file

    made = write_first_file(request, progress)
    return shown(made, first_file_parts(made, request.logs))


@app.command()
@verb
def check(request: CheckRequest, progress: Progress) -> VerbResult:
    """Check a robot file and its logs before a diagnosis, and simulate the model as it is.

    It lists rates, missing and stale rows, units that look wrong, saturation, commands that are cut off and
    contact with a plane, and says which rows a diagnosis will leave out. docs/simgap.md describes the files.
    Exit status 3 says that a diagnosis will refuse the logs.

    Without a robot file it lists what is in the logs: columns, rates and ranges.

    Example: simgap check robot.toml logs.parquet --report check.html
    """
    if request.robot.suffix.lower() != ".toml":
        from simgap.command.first_file import columns_parts, list_logs

        listed = list_logs(request, progress)
        return shown({"logs": listed}, columns_parts(listed))
    from simgap.command.check import check_json, check_parts, check_robot, save_check_page

    report = check_robot(request, progress)
    if request.report is not None:
        save_check_page(report, request.report)
    return shown(check_json(report), check_parts(report), is_done=not report.refusal)


@app.command()
@verb
def diagnose(request: DiagnoseRequest, progress: Progress) -> VerbResult:
    """Find why a robot and its model differ: where, which effect, how far, and what to record next.

    Motions that are held out take no part in the fit, and judge it. docs/simgap.md describes the files, and
    how to read the verdict. The patch holds the changed model, and a file for simgap.patch.runtime.

    Example: simgap diagnose robot.toml logs.parquet --report found.html --patch found
    """
    from simgap.command.diagnosis import diagnose_robot, diagnosis_json, diagnosis_parts, save_diagnosis_files

    made = diagnose_robot(request, progress)
    return shown(diagnosis_json(made), diagnosis_parts(made), save=lambda: save_diagnosis_files(made))


@app.command("next")
@verb
def propose(request: NextRequest, progress: Progress) -> VerbResult:
    """Propose the motion that settles what a diagnosis left open.

    A finding may be a set of effects or a place, or another effect may imitate it: these are rivals. Some
    hundred motions within what the logs show are simulated with each rival. The best one tells most of them
    apart, whatever base parameters absorb. Exit status 3 says that none does; then no commands are written.

    Example: simgap next robot.toml logs.parquet --start found --out next.csv --report next.html
    """
    from simgap.command.next_motion import next_parts, propose_next, save_files
    from simgap.report.next_motion import next_document

    made = propose_next(request, progress)
    return shown(
        next_document(made.proposal),
        next_parts(made),
        is_done=made.proposal.choice.tells_apart,
        save=lambda: save_files(made),
    )


@app.command()
@verb
def compare(request: CompareRequest, progress: Progress) -> VerbResult:
    """Find what changed in a robot between two logs: Monday and Friday, before and after a repair, two units.

    Base parameters and effects are found for both logs together. Then changes of all of them compete to
    explain what differs. It also says which changes these logs cannot show.

    Example: simgap compare robot.toml monday.parquet friday.parquet
    """
    from simgap.command.compare import compare_logs
    from simgap.report.document import comparison_details, comparison_document, comparison_lines

    made = compare_logs(request, progress)
    return shown(comparison_document(made), [*comparison_lines(made), *comparison_details(made)])


def main() -> None:
    """Run the command `simgap`; `simgap.__main__` calls this and reports an interruption."""
    run_app(app, "simgap")
