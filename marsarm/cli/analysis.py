"""Define the verbs that compute: `ik`, `reach`, `budget`, `monte-carlo`, `calibrate`, `arm`, `dictionary`."""

from typing import TYPE_CHECKING, Annotated

import typer

from simgap.common.errors import BadRequest
from simgap.common.progress import Progress
from simgap.common.verb import VerbResult, shown, verb

if TYPE_CHECKING:  # `verb` imports the requests of a verb that is chosen
    import marsarm.accuracy.request
    import marsarm.common.options
    import marsarm.ik.request


@verb
def ik(request: "marsarm.ik.request.IkRequest") -> VerbResult:
    """Compute the five output angles of every branch of a target, or the reason why it is invalid.

    x forward, y right, z down; collisions are not checked. The exit status is 3 if no branch reaches the
    target. With compensation, a branch far outside the limits has no angles, only its approximate excess.

    Example: marsarm ik --tool mahli --position 2.1 0 -0.3 --approach 0.5 0 0.85 --tilt-pitch 10
    """
    from marsarm.ik.solve import ik_document, ik_parts, solve

    report = solve(request)
    document = ik_document(report)
    return shown(document, ik_parts(report), is_done=document["valid"] > 0)


@verb
def reach(request: "marsarm.ik.request.ReachRequest", progress: Progress) -> VerbResult:
    """Count the valid branches in the workspace of an arm, and the reasons why others are invalid.

    That of Curiosity is a cylinder 0.8 m across and 1.0 m tall around RNAV x = 2.1 m, from 0.2 m below the
    ground up; approaches from horizontal to vertical down, to 45 deg on either side. The file of another arm
    may give another one. Collisions are not checked.

    Example: marsarm reach --tool drill --gravity earth --picture drill.png
    """
    from marsarm.ik.reach import reach, reach_document, reach_parts

    report = reach(request, progress)
    return shown(reach_document(report), reach_parts(report))


@verb
def budget(request: "marsarm.accuracy.request.BudgetRequest", progress: Progress) -> VerbResult:
    """Predict the accuracy of the arm before it is built, from eleven sources of error at seven frames.

    Every source is a small rotation or translation of some frames. It is propagated to the tool over the
    primary workspace. The bound of 99.73 percent of the poses is compared with the paper's tables.

    Example: marsarm budget --case accuracy --tool apxs --report budget.html
    """
    from marsarm.accuracy.budget import run_budget
    from marsarm.accuracy.budget_report import budget_document, budget_page, budget_parts
    from simgap.common.report import save_report_page

    result = run_budget(request, progress)
    if request.report is not None:
        save_report_page(budget_page(result), request.report)
    return shown(budget_document(result), budget_parts(result))


@verb
def monte_carlo(request: "marsarm.accuracy.request.MonteCarloRequest", progress: Progress) -> VerbResult:
    """Check the error budget on arms with sampled errors, which flight software moves.

    Every arm has errors of its own, and every move adds random ones. The position error of the tool is
    compared with the bounds of the budget. Arm K is the same whatever other arms there are.

    Example: marsarm monte-carlo --case mars --arms 200 --results mars.jsonl --report mars.html
    """
    from marsarm.accuracy.monte_carlo import run_monte_carlo
    from marsarm.accuracy.monte_carlo_report import monte_carlo_document, monte_carlo_page, monte_carlo_parts
    from simgap.common.report import save_report_page

    result = run_monte_carlo(request, progress)
    if request.report is not None:
        save_report_page(monte_carlo_page(result), request.report)
    return shown(monte_carlo_document(result), monte_carlo_parts(result), is_done=bool(result.trials))


@verb
def calibrate(request: "marsarm.common.options.CalibrateRequest", progress: Progress) -> VerbResult:
    """Find the parameters of an arm and their uncertainty from poses that a laser tracker measured.

    In simulation the whole campaign is run: hardstops, every move by flight software, two stand-in turrets,
    level and rolled. Parameters that the poses cannot separate keep their nominal values and are listed.

    Example: marsarm calibrate --arm as-built:7 --out arm7.toml --verify 10 --report calibration.html
    """
    from marsarm.calibration.execution import run_calibration
    from marsarm.calibration.report import calibration_document, calibration_page, calibration_parts
    from simgap.common.report import save_report_page

    result = run_calibration(request, progress)
    if request.report is not None:
        save_report_page(calibration_page(result), request.report)
    return shown(calibration_document(result), calibration_parts(result))


@verb
def arm(request: "marsarm.common.options.ArmRequest") -> VerbResult:
    """List the arms of the project, show one, or make its files.

    Without a name it lists them. With one it shows links, joints and frames at the pose above the workspace.
    --build makes arm.xml, the MJCF of the plant, and flight.toml, the flight parameters; an arm that cannot
    be homed, stowed or brought to its workspace is refused. These files are for people and other tools.

    Example: marsarm arm m2020 --picture m2020-layout.png
    """
    from marsarm.arms.arm import (
        arms_table,
        build_arms,
        describe_arm,
        layout_document,
        layout_parts,
        save_layout_picture,
        show_arm,
    )
    from simgap.common.report import file_lines

    if request.build:
        built = build_arms(request)
        arms = [{**describe_arm(one.model), "files": [*one.texts]} for one in built]
        return shown({"arms": arms}, [f"{one.model.name}  {path}" for one in built for path in one.texts])
    if request.arm is None and request.picture is None:
        from sim.arm_model.load import arm_names, load_arm

        models = [load_arm(name) for name in arm_names()]
        return shown({"arms": [describe_arm(model) for model in models]}, [arms_table(models)])
    layout, picture = show_arm(request), request.picture
    if picture is not None:
        save_layout_picture(layout, picture)
    return shown(layout_document(layout), [*layout_parts(layout), *file_lines({"picture": picture})])


@verb
def dictionary(
    pattern: Annotated[
        str | None,
        typer.Argument(
            help="Name of a command, EVR, topic, field or parameter; * stands for any letters.",
            metavar="GLOB",
        ),
    ] = None,
    effects: Annotated[
        bool, typer.Option("--effects", help="List the effects of the plant: meaning, places and parameters.")
    ] = False,
) -> VerbResult:
    """List every command, event report, channel and parameter, with type, unit, limits and meaning.

    The list is made from the classes that flight software runs on. Truth channels of the plant are marked. To
    use an effect, give --effect to run, place or hardstop, or write an `effect` table in a scenario.

    Example: marsarm dictionary 'joints.elbow.*'
    """
    if effects and pattern is not None:
        raise BadRequest("dictionary: --effects lists all effects; give no GLOB with it")
    from marsarm.dictionary.tables import dictionary_parts, effects_json, effects_parts

    if effects:
        return shown({"effects": effects_json()}, effects_parts())
    from marsarm.dictionary.entries import build_dictionary, filter_dictionary

    whole = build_dictionary()
    part = whole if pattern is None else filter_dictionary(whole, pattern)
    return shown(part, dictionary_parts(part))
