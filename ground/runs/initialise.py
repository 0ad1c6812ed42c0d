"""What comes before an arm is stowed: every joint has been at its hardstop."""

from fsw.dictionary.enums import HARDSTOP_ORDER
from ground.common.progress import Progress
from sim.arms import BuiltArm
from sim.initialisation import InitialisationResult, initialise_joints


def initialise(arm: BuiltArm, seed: int, progress: Progress) -> list[InitialisationResult]:
    """Every joint at its hardstop, one after the other; the last one of the list may have failed."""
    stops: list[InitialisationResult] = []
    for run in initialise_joints(arm, seed=seed):
        if run.failure is not None:
            raise run.failure
        stops.append(run)
        progress(len(stops), len(HARDSTOP_ORDER), "initialising")
    return stops
