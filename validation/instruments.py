"""Campaign of the tools that a job begins with: each is placed on random targets from the ready pose.

The rover is tilted by up to 30 deg in a random direction. A placement is complete when every command is,
and a switch of the tool is closed and the rock pushes after the brakes are on. Targets are drawn until flight
software plans one; what it refuses in the run, with the noise of the sensors, does not count.

A tool without switches cannot touch. The portion tube has none, as flown: its placement is the delivery of a
sample, over a taught inlet, and is complete when every check of that scenario passes.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Final

import numpy as np

from fsw.dictionary.evrs import Evr
from fsw.dictionary.faults import ContactLost, Fault
from fsw.estimate.reference import Reference
from marsarm.common.rates import clopper_pearson
from sim.arms import arm_named
from sim.initialisation import initial_reference
from sim.loop import ClosedLoop, Setup
from sim.placement import place_command, random_placement
from sim.scenario.file import load_scenario
from sim.scenario.run import ScenarioRun, scenario_setup, teach
from sim.sequence import Outcome, run_commands
from validation.campaigns import Context, Document

TILT_RAD: Final = float(np.radians(30.0))
DELIVERY: Final = "delivery"
LEAST_SHARE: Final = 0.98
"""Least share of accepted placements that are completed."""


@dataclass(frozen=True, slots=True)
class ToolRun:
    """Tool, brought to one target."""

    tool: str
    arm: str
    number: int
    """Seed of target, tilt and noise."""
    accepted: bool
    """Whether flight software refused no command."""
    completed: bool
    """Whether every command is done, and the tool is where it was to be."""
    lateral_mm: float
    """Distance of the true tool from the axis through its target."""
    force_N: float
    """True force on the tool at the end."""
    faults: tuple[str, ...]


def one_arm(name: str, tools: tuple[str, ...], targets: int) -> list[ToolRun]:
    """Bring each tool to this many random targets, on one arm that has found its hardstops."""
    reference = initial_reference(arm_named(name))
    return [bring_tool(name, reference, tool, draw) for tool in tools for draw in range(1, targets + 1)]


def bring_tool(name: str, reference: Reference, tool: str, draw: int) -> ToolRun:
    """Bring a tool to where it works, from the ready pose, and say where it is at the end."""
    number = 1000 * int(name.partition(":")[2] or 0) + draw
    if arm_named(name).params.tool_switches[tool]:
        return _place(name, reference, tool, number)
    return _deliver(name, reference, tool, number)


def _place(name: str, reference: Reference, tool: str, number: int) -> ToolRun:
    """Place a tool on a random rock."""
    arm = arm_named(name)
    world, preview = random_placement(number, arm, tool, TILT_RAD)
    loop = ClosedLoop(Setup(arm, world, arm.params.poses.ready_rad, number, reference))
    command = place_command(preview.placement)
    result = run_commands(loop, command)
    truth, axis_R = loop.truth(), np.array(command.approach_R)
    off_m = truth.p_RoTo_R_m[loop.plant.tools.index(tool)] - np.array(command.p_RoTo_R_m)
    switches = list(loop.config.protection.tool_switches[tool])
    is_closed = bool(result.cycles[-1].sensors.switch_closed[switches].any())
    touches = is_closed and truth.contact_force_N > 0.0 and loop.braked
    return ToolRun(
        tool,
        name,
        number,
        accepted=result.outcome != Outcome.REFUSED,
        completed=result.outcome == Outcome.DONE and touches,
        lateral_mm=1e3 * float(np.linalg.norm(off_m - (off_m @ axis_R) * axis_R)),
        force_N=truth.contact_force_N,
        faults=_faults(evr for _, evr in result.evrs),
    )


def _deliver(name: str, reference: Reference, tool: str, number: int) -> ToolRun:
    """Bring a tool over an inlet, with the rover tilted in a random direction."""
    rng = np.random.default_rng([number, 4])
    tilt_rad, heading_rad = rng.uniform(0.0, TILT_RAD), rng.uniform(-np.pi, np.pi)
    roll_rad, pitch_rad = (float(tilt_rad * part(heading_rad)) for part in (np.cos, np.sin))
    scenario = load_scenario(DELIVERY).tilted(roll_rad, pitch_rad)
    arm = teach(arm_named(name), reference, scenario.taught, scenario.world)
    run = ScenarioRun(ClosedLoop(scenario_setup(scenario, arm, reference, number)), scenario)
    for _ in run:
        pass
    result = run.result()
    return ToolRun(
        tool,
        name,
        number,
        accepted=result.outcome != Outcome.REFUSED,
        completed=result.passed,
        lateral_mm=max(1e3 * one.value for one in result.checks if one.name == "from the axis"),
        force_N=0.0,
        faults=_faults(evr for _, evr in result.evrs),
    )


def _faults(evrs: Iterable[Evr]) -> tuple[str, ...]:
    return tuple(evr.message for evr in evrs if isinstance(evr, Fault))


def summary(runs: list[ToolRun]) -> Document:
    """Count what was accepted, completed and lost of one tool, with the 95 % interval of the share."""
    accepted = [run for run in runs if run.accepted]
    completed = sum(run.completed for run in accepted)
    return {
        "accepted": len(accepted),
        "completed": completed,
        "share": completed / len(accepted) if accepted else 0.0,
        "interval 95 %": [*clopper_pearson(completed, len(accepted))],
        "lost_contact": sum(ContactLost(run.tool).message in run.faults for run in accepted),
        "refused": len(runs) - len(accepted),
        "force_N": sorted(run.force_N for run in accepted),
        "lateral_mm": sorted(run.lateral_mm for run in accepted),
        "failed": [asdict(run) for run in accepted if not run.completed],
    }


def campaign(
    context: Context, nominal: int = 20, calibrated: int = 6, each: int = 3, only: str = ""
) -> Document:
    """Bring every tool to this many targets on the nominal arm, and to some on each calibrated arm.

    Args:
        nominal: Targets of each tool on the nominal arm.
        calibrated: Number of calibrated arms.
        each: Targets of each tool on each of these.
        only: Tools, with commas; all if empty.
    """
    tools = tuple(only.split(",")) if only else arm_named("nominal").params.tool_names
    jobs: list[tuple[str, tuple[str, ...], int]] = [("nominal", (tool,), nominal) for tool in tools]
    jobs += [(f"calibrated:{context.seed + k + 1}", tools, each) for k in range(calibrated)]
    runs = [run for arm in context.each(one_arm, jobs, "arms and tools") for run in arm]
    table = {tool: summary([run for run in runs if run.tool == tool]) for tool in tools}
    good = (one["share"] >= LEAST_SHARE and one["lost_contact"] == 0 for one in table.values())
    return {"tools": table, "in_bounds": all(good)}
