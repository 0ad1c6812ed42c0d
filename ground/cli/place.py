"""Define the verb `place`."""

from ground.cli.verb import VerbResult, verb
from ground.common.progress import Progress
from ground.runs.request import PlaceRequest


@verb
def place(request: PlaceRequest, progress: Progress) -> VerbResult:
    """Unstow, place an instrument on a rock, and retract.

    RNAV is x forward, y right, z down, from the ground below the rover: a rock 0.25 m high has z = -0.25.

    Example: marsarm place --tool mahli --target 2.1 0 -0.2 --normal -0.4 0 -1 --tilt-pitch 10
    """
    from ground.runs.place import place
    from ground.runs.tables import place_json, place_table

    report = place(request, progress)
    is_done = report.execution.result.outcome == "done"
    return VerbResult(place_json(report), lambda: place_table(report), is_done)
