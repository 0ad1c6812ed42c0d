"""Requests of `marsarm budget` and `monte-carlo`: their options, with defaults and bounds."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from marsarm.common.options import MismatchOption, ParamsOption
from simgap.common.options import ClusterOption, Option, ReportOption, WorkersOption

ArmKind = Literal["sampled", "calibrated", "as-built"]
MoveModel = Literal["closed-loop", "statics"]


@dataclass(frozen=True, slots=True)
class BudgetRequest:
    """Request for an error budget."""

    case: Annotated[
        str,
        Option(
            "accuracy and repeatability: before calibration, the paper's Table 3; mars and "
            "mars-repeatability: after it, Table 4.",
            "CASE|all",
        ),
    ] = "all"
    tool: Annotated[str, Option("A tool of the arm, or all.", "TOOL|all")] = "all"
    poses: Annotated[
        int, Option("Number of random poses in the workspace, over all branches.", within=(100, 200_000))
    ] = 15_000
    seed: Annotated[int, Option("Seed of the random poses.", within=(0, None))] = 0
    params: ParamsOption = None
    mismatch: MismatchOption = False
    gravity: Annotated[str, Option("mars or earth.", "mars|earth")] = "mars"
    report: ReportOption = None


@dataclass(frozen=True, slots=True)
class MonteCarloRequest:
    """Request for a Monte Carlo."""

    case: Annotated[str, Option("accuracy, repeatability, mars or mars-repeatability.", "CASE")] = "accuracy"
    built: Annotated[
        ArmKind,
        Option(
            "sampled: the nominal arm with every source of the case. calibrated or as-built: such arms, "
            "with the sources that the case adds to them.",
            "sampled|calibrated|as-built",
        ),
    ] = "sampled"
    arms: Annotated[int, Option("Number of arms.", within=(1, 1_000_000))] = 500
    places: Annotated[int, Option("Number of places that each arm is moved to.", within=(1, 1000))] = 1
    move_model: Annotated[
        MoveModel,
        Option(
            "closed-loop: plant and flight software. statics: the equilibrium of motors, gears and springs "
            "after a move, more than ten times faster.",
            "closed-loop|statics",
        ),
    ] = "closed-loop"
    seed: Annotated[
        int,
        Option("Seed of arms, places and moves; calibrated arm K is calibrated:SEED+K.", within=(0, None)),
    ] = 0
    workers: WorkersOption = None
    cluster: ClusterOption = None
    params: ParamsOption = None
    mismatch: MismatchOption = False
    results: Annotated[
        Path | None,
        Option(
            "Write the measurements arm by arm; an interrupted run continues from this file.",
            "FILE.jsonl",
            suffixes=(".jsonl",),
        ),
    ] = None
    report: ReportOption = None
