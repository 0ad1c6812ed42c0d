"""Define the verbs of the diagnosis: `gap record`, `gap demo` and `diagnose`."""

import sys
from typing import TYPE_CHECKING

from simgap.common.app import VerbApp
from simgap.common.progress import Progress
from simgap.common.verb import VerbResult, shown, verb

if TYPE_CHECKING:  # `verb` imports the requests of a verb that is chosen
    import marsarm.diagnosis.arm.request

gap_app = VerbApp(
    help="Record logs from which `marsarm diagnose` finds why arm and simulation differ, or try it.\n\n"
    "Example: marsarm gap demo --seed 101"
)


@gap_app.command()
@verb
def record(request: "marsarm.diagnosis.arm.request.RecordRequest", progress: Progress) -> VerbResult:
    """Record the campaign of motions for `marsarm diagnose`; it takes half a minute.

    Logs hold no truth of the plant. Motions to validate a diagnosis on are in DIR/held-out.

    Example: marsarm gap record --effect link-length:arm3.x:length_m=0.003 --out logs
    """
    from marsarm.diagnosis.arm.record import record_logs

    found = record_logs(request, progress)
    document = {"logs": [str(path) for path in found.logs], "left_out": list(found.left_out)}
    left_out = f"; the arm did not complete {', '.join(found.left_out)}" if found.left_out else ""
    count = "1 log" if len(found.logs) == 1 else f"{len(found.logs)} logs"
    return shown(document, [f"{count} in {request.out}{left_out}"])


@gap_app.command("next")
@verb
def propose(request: "marsarm.diagnosis.arm.request.NextRequest", progress: Progress) -> VerbResult:
    """Diagnose logs, and propose the motion that settles what the diagnosis leaves open.

    A finding may be a set of effects or a place, or another effect may imitate it: these are rivals. Sweeps
    and poses that the campaign does not have are simulated with each rival; the best one tells most of them
    apart, whatever calibration errors absorb. It takes some ten minutes. Exit status 3 says that none does.

    Example: marsarm gap next logs --held-out logs/held-out --out next.toml --report next.html
    """
    from marsarm.diagnosis.arm.next_motion import propose_next, save_files
    from simgap.report.next_motion import next_document, next_lines, next_tables

    made = propose_next(request, progress)
    is_done = made.proposal.choice.tells_apart
    tables = next_tables(made.proposal) if is_done else ()
    parts = [*next_lines(made.proposal), *tables]
    return shown(next_document(made.proposal), parts, is_done, save=lambda: save_files(made))


@gap_app.command()
@verb
def demo(request: "marsarm.diagnosis.arm.request.DemoRequest", progress: Progress) -> VerbResult:
    """Draw an effect that is not printed, record an arm with it, diagnose the logs, and open the seal.

    In one of four demonstrations the catalogue lacks the effect; in one of ten there is none. The first
    demonstration computes the sensitivities of the campaign, which takes six minutes of one core; later ones
    take one.

    Four lines say what the logs show; then come the truth, and whether the lines are right.

    Example: marsarm gap demo --seed 101 --report demo.html
    """
    from marsarm.diagnosis.arm.demo import demo_json, run_demo
    from simgap.common.files import json_sha256
    from simgap.common.options import command_text
    from simgap.common.page import Origin
    from simgap.common.report import file_lines
    from simgap.report.page import save_diagnosis_page
    from simgap.report.sentences import verdict_lines

    def publish(digest: str) -> None:
        print(f"SHA-256 of the truth: {digest}", file=sys.stderr)

    found = run_demo(request, progress, publish)

    def save() -> list[str]:
        if request.report is not None:
            digests = {"result": json_sha256(demo_json(found)), "truth": found.truth.digest()}
            origin = Origin(command_text("marsarm gap demo", request), digests)
            save_diagnosis_page(found.case.diagnosis, found.case.traces, request.report, origin)
        return file_lines({"report": request.report})

    truth = found.truth
    on = f"{truth.spec}, {truth.times_limit:.1f} detection limits" if truth.spec else "no effect"
    left_out = "; left out of the catalogue" if truth.kind == "left out" else ""
    right = f"{'yes' if found.is_right else 'no'}: {found.reason}."
    lines = [*verdict_lines(found.case.diagnosis), f"Truth: {on}{left_out}.", f"Right: {right}"]
    return shown(demo_json(found), lines, save=save)


@verb
def diagnose(request: "marsarm.diagnosis.arm.request.DiagnoseRequest", progress: Progress) -> VerbResult:
    """Find why an arm and its simulation differ: the effect, its place and the residual that remains.

    Four lines say where the gap is, its cause and how sure that is, how far it shrinks, and what to record.

    Example: marsarm diagnose logs/ --held-out more/ --report gap.html --patch found.toml
    """
    from marsarm.diagnosis.arm.diagnose_logs import diagnose as diagnose_logs
    from marsarm.diagnosis.arm.diagnose_logs import save_diagnosis_files
    from simgap.command.diagnosis import all_lines
    from simgap.report.document import to_document

    result = diagnose_logs(request, progress)
    lines = all_lines(result.diagnosis)
    return shown(to_document(result.diagnosis), lines, save=lambda: save_diagnosis_files(result, request))
