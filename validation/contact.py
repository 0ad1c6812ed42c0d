"""Campaign of contacts at rest: APXS placements and tool changes to MAHLI on many calibrated arms.

From 0.5 s after the last change of set-point, no contact is lost and no switch changes. The force stays
within 20 % of its mean over the last second; from 2 s on, or once the brakes hold, within 5 %.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import chain

import numpy as np

from fsw.config import CYCLE_HZ
from fsw.dictionary.commands import Command, ToolChange
from fsw.dictionary.evrs import Evr
from fsw.dictionary.types import joints5
from marsarm.common.pool import Runner, in_order
from sim.arms import arm_named
from sim.clearance import tool_forces
from sim.initialisation import true_reference
from sim.loop import ClosedLoop, Setup
from sim.placement import place_command, random_placement
from sim.sequence import run_sequence
from validation.options import campaign_parser, campaign_runner
from validation.tool_change import FIRST, SECOND, TILT_RAD, not_completed

SOON_S, LATER_S, HELD_S = 0.5, 2.0, 4.0
SOON, LATER = 0.20, 0.05
"""Largest deviations of the force from its mean, as a share of it."""
MOST_DRAWS = 25
"""Largest number of targets that are tried on an arm."""


@dataclass(frozen=True, slots=True)
class ContactRest:
    """Contact of a tool, from the touch until 4 s after the command."""

    arm: str
    tool: str
    mean_N: float
    """Mean force over the last second."""
    force_error_0_5_s: float
    """Largest deviation of the force from its mean from 0.5 s on, as a share of it."""
    force_error_2_s: float
    """Likewise from 2 s on or once the brakes hold."""
    lost: int
    """Cycles without contact."""
    switched: int
    """Changes of a switch of the tool."""

    @property
    def in_bounds(self) -> bool:
        """True if the contact is at rest within the bounds."""
        return (
            self.force_error_0_5_s < SOON and self.force_error_2_s < LATER and self.lost == self.switched == 0
        )


def rest_after(loop: ClosedLoop, commands: Sequence[Command], tool: str, arm: str = "") -> ContactRest | str:
    """Measure the contact of a tool that touches at the end of these commands.

    The loop runs until 4 s after the last command.

    Returns:
        The measured contact, or the warning that ended the commands early.
    """
    evrs: list[Evr] = []
    force_N, closed, setpoint_count, braked = [], [], [], []
    commanded = run_sequence(loop, commands)
    for record in chain(commanded, (loop.cycle() for _ in range(round(HELD_S * CYCLE_HZ)))):
        evrs += record.outputs.evrs
        force_N.append(float(np.linalg.norm(tool_forces(loop.plant)[loop.plant.tools.index(tool)])))
        closed.append(record.sensors.switch_closed[list(loop.config.protection.tool_switches[tool])])
        setpoint_count.append(record.outputs.drive.setpoint_count)
        braked.append(loop.braked)
    problem = not_completed(commands[-1], evrs)
    if problem is not None:
        return problem
    last = int(np.flatnonzero(np.diff(np.array(setpoint_count), axis=0).any(axis=1))[-1]) + 1
    soon = last + round(SOON_S * CYCLE_HZ)
    later = min(last + round(LATER_S * CYCLE_HZ), max(soon, braked.index(True, last)))
    force, mean_N = np.array(force_N), float(np.mean(force_N[-CYCLE_HZ:]))
    deviation = np.abs(force - mean_N) / mean_N
    changes = np.diff(np.array(closed[soon:]).astype(int), axis=0)
    return ContactRest(
        arm,
        tool,
        mean_N,
        force_error_0_5_s=float(deviation[soon:].max()),
        force_error_2_s=float(deviation[later:].max()),
        lost=int(np.sum(force[soon:] == 0.0)),
        switched=int(np.abs(changes).sum()),
    )


def one_arm(seed: int) -> list[ContactRest]:
    """Measure a placement and a tool change of one arm, at the first target where both succeed."""
    name = f"calibrated:{seed}"
    arm = arm_named(name)
    for draw in range(1, MOST_DRAWS + 1):
        world, preview = random_placement(1000 * seed + draw, arm, FIRST, TILT_RAD)
        loop = ClosedLoop(Setup(arm, world, joints5(preview.standoff_rad), draw, true_reference(arm)))
        first = rest_after(loop, (place_command(preview.placement),), FIRST, name)
        second = (
            rest_after(loop, (ToolChange(SECOND),), SECOND, name) if isinstance(first, ContactRest) else first
        )
        if isinstance(first, ContactRest) and isinstance(second, ContactRest):
            return [first, second]
    raise RuntimeError(f"{name}: no tool change was carried out at {MOST_DRAWS} targets")


def document(arms: int, seed: int, run: Runner) -> dict[str, object]:
    """Measure this many arms; in bounds if every contact is at rest."""
    found: list[ContactRest] = []
    for k, rests in enumerate(in_order(run, one_arm, ((seed + arm,) for arm in range(arms))), start=1):
        found += rests
        print(f"\rcontacts: {k} of {arms} arms", end="", file=sys.stderr)
    print(file=sys.stderr)
    return {
        "contacts": len(found),
        "max_force_error_0_5_s": max(rest.force_error_0_5_s for rest in found),
        "max_force_error_2_s": max(rest.force_error_2_s for rest in found),
        "not_at_rest": [asdict(rest) for rest in found if not rest.in_bounds],
        "in_bounds": all(rest.in_bounds for rest in found),
    }


def main() -> int:
    """Print the result as JSON; return 1 if a contact is not at rest."""
    parser = campaign_parser("contact", __doc__, "example: python -m validation.contact --arms 3")
    parser.add_argument("--arms", type=int, default=20, help="calibrated arms (default %(default)s)")
    options = parser.parse_args()
    found = document(options.arms, options.seed, campaign_runner(options))
    print(json.dumps(found, indent=2))
    return 0 if found["in_bounds"] else 1


if __name__ == "__main__":
    sys.exit(main())
