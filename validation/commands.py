"""Campaign of commands: random ones of right and wrong types in the closed loop, from huge to tiny numbers.

Flight software must not end with an exception or a warning. A cycle whose commands are all refused must drive
the actuators, to the last bit, as one without commands.
"""

import json
import sys
import warnings
from collections import Counter
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np

from fsw.config import Config
from fsw.cycle import step
from fsw.dictionary.enums import Mode
from fsw.dictionary.evrs import CommandAccepted, CommandRefused
from fsw.dictionary.params import TeachPoint
from fsw.messages import ActuatorCommand, Sensors
from fsw.state import State
from marsarm.common.pool import Runner
from sim.arms import arm_named
from sim.initialisation import start_loop
from sim.loop import ClosedLoop
from sim.record import CycleRecord
from validation.command_draws import draw_command
from validation.options import campaign_parser, campaign_runner

RUN_CYCLES: Final = 500
"""Cycles from a start of the arm; after more, most arms have a standing fault or unfit parameters."""
COMMAND_SHARE: Final = {True: 0.1, False: 0.6}
"""Share of cycles with commands while the arm moves, and while it rests."""
MOST_COMMANDS: Final = 3
LONGEST_REASON: Final = 400
"""Longest reason of a refusal; lists of names have up to 300 characters."""
DRIVE_FIELDS: Final = tuple(field.name for field in fields(ActuatorCommand))
HERE: Final = TeachPoint("here", "apxs", (1.4, 0.0, -0.3), (0.0, 0.0, 1.0))


@dataclass(frozen=True, slots=True)
class RunResult:
    """Commands of a run by what became of them, and the bugs that were found."""

    cycles: int
    commands: int
    accepted: dict[str, int]
    refused: dict[str, int]
    bugs: tuple[str, ...]


def fuzz_run(job: tuple[int, int, int]) -> RunResult:
    """Run an arm under random commands; a job is a seed, the number of the run, and its cycles."""
    seed, number, cycles = job
    random = np.random.default_rng([seed, number])
    loop = start(number)
    commands_sent, accepted, refused = 0, Counter[str](), Counter[str]()
    bugs: list[str] = []
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for done in range(cycles):
            share = COMMAND_SHARE[loop.state.move is not None]
            sent = random.integers(1, MOST_COMMANDS + 1) if random.random() < share else 0
            commands = tuple(draw_command(random, loop.config.params) for _ in range(sent))
            before, commands_sent = loop.state, commands_sent + len(commands)
            record = loop.cycle(commands)
            accepted.update(evr.command for evr in record.outputs.evrs if isinstance(evr, CommandAccepted))
            refused.update(evr.command for evr in record.outputs.evrs if isinstance(evr, CommandRefused))
            bugs += [f"run {number}, cycle {done}: {bug}" for bug in find_bugs(loop, before, record)]
            if loop.failure is not None:
                return RunResult(done + 1, commands_sent, dict(accepted), dict(refused), tuple(bugs))
    return RunResult(cycles, commands_sent, dict(accepted), dict(refused), tuple(bugs))


def start(number: int) -> ClosedLoop:
    """Start an arm with a taught point: in turn stowed, ready, and where joints find hardstops."""
    arm = arm_named("nominal")
    arm = replace(arm, params=replace(arm.params, teach=(HERE,)))
    poses = (arm.params.poses.stowed_rad, arm.params.poses.ready_rad, arm.params.hardstop.start_rad)
    return start_loop(arm, start_rad=poses[number % len(poses)], seed=number, with_truth=False)


def find_bugs(loop: ClosedLoop, before: State, record: CycleRecord) -> list[str]:
    """Describe what a cycle shows that must not be."""
    if loop.failure is not None:
        return [f"{type(loop.failure).__name__}: {loop.failure}; commands {record.commands!r:.2000}"]
    reasons = [evr.reason for evr in record.outputs.evrs if isinstance(evr, CommandRefused)]
    bugs = [f"a reason of {len(reason)} characters" for reason in reasons if len(reason) > LONGEST_REASON]
    if record.commands and len(reasons) >= len(record.commands):
        bugs += _find_change(loop.config, before, record.sensors, record)
    return bugs


def _find_change(config: Config, before: State, sensors: Sensors, record: CycleRecord) -> list[str]:
    """Compare a cycle of refused commands with the same cycle without commands."""
    state, quiet = step(config, before, sensors, ())
    others = [evr for evr in quiet.evrs if isinstance(evr, CommandRefused)]
    refused = sum(isinstance(evr, CommandRefused) for evr in record.outputs.evrs) - len(others)
    if refused != len(record.commands):
        return []
    left = [evr for evr in record.outputs.evrs if not isinstance(evr, CommandRefused)]
    same_events = left == [evr for evr in quiet.evrs if not isinstance(evr, CommandRefused)]
    drive, still = record.outputs.drive, quiet.drive
    same_drive = all(np.array_equal(getattr(drive, name), getattr(still, name)) for name in DRIVE_FIELDS)
    if same_events and same_drive and state.mode is Mode(record.outputs.joint.mode):
        return []
    return [f"refused commands changed the cycle: {record.commands!r:.2000}"]


def campaign(cycles: int, seed: int, runner: Runner) -> dict[str, Any]:
    """Run all cycles; the same arguments give the same result."""
    runs = -(-cycles // RUN_CYCLES)
    jobs = [(seed, k, min(RUN_CYCLES, cycles - k * RUN_CYCLES)) for k in range(runs)]
    results = list(runner(fuzz_run, jobs))
    accepted = sum((Counter(one.accepted) for one in results), Counter[str]())
    refused = sum((Counter(one.refused) for one in results), Counter[str]())
    bugs = [bug for one in results for bug in one.bugs]
    return {
        "cycles": sum(one.cycles for one in results),
        "seed": seed,
        "in_bounds": not bugs,
        "commands": sum(one.commands for one in results),
        "accepted": dict(accepted.most_common()),
        "refused": dict(refused.most_common()),
        "bugs": bugs,
    }


def main() -> int:
    """Print the result as JSON; return 1 if a bug was found."""
    parser = campaign_parser("commands", __doc__, "example: python -m validation.commands --cycles 250000")
    parser.add_argument(
        "--cycles", type=int, default=250_000, help="cycles of all runs (default %(default)s)"
    )
    options = parser.parse_args()
    if options.cycles < 1 or options.seed < 0:
        parser.error("cycles are 1 or more, the seed is not negative")
    found = campaign(options.cycles, options.seed, campaign_runner(options))
    print(json.dumps(found, indent=2))
    return 0 if found["in_bounds"] else 1


if __name__ == "__main__":
    sys.exit(main())
