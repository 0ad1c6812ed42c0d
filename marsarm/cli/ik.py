"""Define the verbs of the inverse kinematics: `ik` and `reach`."""

from marsarm.ik.request import IkRequest, ReachRequest
from simgap.common.progress import Progress
from simgap.common.verb import VerbResult, verb


@verb
def ik(request: IkRequest, progress: Progress) -> VerbResult:
    """Compute the five output angles of every branch of a target, or the reason why it is invalid.

    x forward, y right, z down; collisions are not checked. The exit status is 0 also if no branch reaches the
    target. With compensation, a branch far outside the limits has no angles, only its approximate excess.

    Example: marsarm ik --tool mahli --position 2.1 0 -0.3 --approach 0.5 0 0.85 --tilt-pitch 10
    """
    from marsarm.ik.report import batch_json, batch_table, ik_json, ik_table
    from marsarm.ik.solve import IkReport, solve

    report = solve(request, progress)
    if isinstance(report, IkReport):
        return VerbResult(ik_json(report), lambda: ik_table(report))
    return VerbResult(batch_json(report), lambda: batch_table(report))


@verb
def reach(request: ReachRequest, progress: Progress) -> VerbResult:
    """Count the valid branches in the workspace of an arm, and the reasons why others are invalid.

    That of Curiosity is a cylinder 0.8 m across and 1.0 m tall around RNAV x = 2.1 m, from 0.2 m below the
    ground up; approaches from horizontal to vertical down, to 45 deg on either side. The file of another arm
    may give another one. Collisions are not checked.

    Example: marsarm reach --tool drill --gravity earth --picture drill.png
    """
    from marsarm.ik.reach import reach
    from marsarm.ik.report import reach_json, reach_table

    report = reach(request, progress)
    return VerbResult(reach_json(report), lambda: reach_table(report))
