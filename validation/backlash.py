"""Campaign of the backlash estimate: estimated and true side of each joint after random moves.

Each tour is a sequence of poses at a random tilt, in all branches, with reversals and small moves. Tours run
with backlash compensation, and a fifth of them also without.
"""

import json
import sys
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from fsw.config import configure
from fsw.dictionary.commands import BacklashMode
from fsw.dictionary.enums import Joint
from fsw.estimate.reference import Reference
from marsarm.common.pool import Runner, in_order
from sim.arms import arm_named
from sim.initialisation import initial_reference
from sim.pose_sequence import RestState, random_poses, visit_poses
from sim.world import World
from validation.options import campaign_parser, campaign_runner

EXAMPLE = "example: python -m validation.backlash --sequences 20 --poses 50 --arm nominal > backlash.json"
MAX_TILT_RAD: Final = float(np.radians(30.0))
LEAST_RATIO: Final = 10.0
"""Least ratio of the tool error from backlash without compensation to that with it."""


def one_tour(
    arm_name: str, reference: Reference, backlash: BacklashMode, poses: int, seed: int
) -> list[RestState]:
    """Visit the poses of a tour, with tilt and goals from the seed."""
    arm = arm_named(arm_name)
    rng = np.random.default_rng([seed, 4])
    tilt, heading = rng.uniform(0.0, MAX_TILT_RAD), rng.uniform(-np.pi, np.pi)
    world = World("mars", float(tilt * np.cos(heading)), float(tilt * np.sin(heading)))
    goals = random_poses(configure(arm.params), rng, poses)
    return list(visit_poses(arm, reference, world, goals, backlash, seed))


def summary(friction_Nm: np.ndarray, settled: Sequence[RestState]) -> dict[str, Any]:
    """Summarize the claimed sides of the backlash, and the errors of outputs and tool.

    Args:
        friction_Nm: Friction of the outputs, shape (5,).
        settled: States of the arm at rest.
    """
    claimed = np.array([s.side for s in settled])
    true = np.array([s.true_side for s in settled])
    loaded = np.abs([s.load_Nm for s in settled]) > friction_Nm
    error = np.array([s.output_rad - s.pose_rad for s in settled])
    known = claimed != 0
    shift = np.linalg.norm([s.backlash_shift_m for s in settled], axis=1)
    believed = np.array([s.gear_rad - s.believed_gear_rad for s in settled])
    return {
        "poses": len(settled),
        "joint_poses": int(known.size),
        "claimed_share": float(known.mean()),
        "claimed_share_of_loaded": float(known[loaded].mean()),
        "floating_share": float(1.0 - known.mean()),
        "right_share_of_claimed": float((claimed == true)[known].mean()),
        "wrong_claims": int(np.count_nonzero((claimed != true) & known)),
        "output_error_rms_mrad": {"claimed": _rms_mrad(error[known]), "floating": _rms_mrad(error[~known])},
        "believed_output_error_rms_mrad": {
            "claimed": _rms_mrad(believed[known]),
            "floating": _rms_mrad(believed[~known]),
        },
        "by_joint": {
            joint.name.lower(): {
                "claimed_share": float(known[:, joint].mean()),
                "output_error_rms_mrad": _rms_mrad(error[known[:, joint], joint]),
            }
            for joint in Joint
        },
        "tool_error_from_backlash_mm": {
            "rms": 1e3 * float(np.sqrt(np.mean(shift**2))),
            "max": 1e3 * float(shift.max()),
        },
    }


def campaign(arm_name: str, sequences: int, poses: int, seed: int, run: Runner) -> dict[str, Any]:
    """Run all sequences, with and without compensation; the same arguments give the same result."""
    friction = configure(arm_named(arm_name).params).output_friction_Nm
    result: dict[str, Any] = {"arm": arm_name, "pose_sequences": sequences, "seed": seed}
    modes: tuple[BacklashMode, ...] = ("on", "off")
    # A fifth of the sequences is enough to measure the effect of backlash without compensation.
    jobs = [
        (mode, seed + k)
        for mode in modes
        for k in range(sequences if mode == "on" else max(1, sequences // 5))
    ]
    found: dict[str, list[RestState]] = {mode: [] for mode in modes}
    arm, seeds = arm_named(arm_name), range(seed, seed + sequences)
    known = dict(zip(seeds, in_order(run, initial_reference, ((arm, s) for s in seeds)), strict=True))
    tours = in_order(run, one_tour, ((arm_name, known[s], mode, poses, s) for mode, s in jobs))
    for done, ((mode, _), rests) in enumerate(zip(jobs, tours, strict=True), 1):
        found[mode].extend(rests)
        print(f"marsarm: {done} of {len(jobs)} sequences", file=sys.stderr)
    for mode in modes:
        result[f"backlash_{mode}"] = summary(friction, found[mode])
    tool = "tool_error_from_backlash_mm"
    result["tool_error_ratio"] = result["backlash_off"][tool]["rms"] / result["backlash_on"][tool]["rms"]
    wrong = sum(result[f"backlash_{mode}"]["wrong_claims"] for mode in modes)
    result["in_bounds"] = wrong == 0 and result["tool_error_ratio"] > LEAST_RATIO
    return result


def _rms_mrad(error: np.ndarray) -> float | None:
    return 1e3 * float(np.sqrt(np.mean(error**2))) if error.size else None


def main() -> int:
    """Print the result as JSON; return 1 if a claimed side is wrong, or compensation helps too little."""
    parser = campaign_parser("backlash", __doc__, EXAMPLE)
    parser.add_argument("--arm", default="nominal", help="nominal, as-built:SEED or calibrated:SEED")
    parser.add_argument("--sequences", type=int, default=20, help="sequences of each kind (default 20)")
    parser.add_argument("--poses", type=int, default=50, help="settled poses a tour (default 50)")
    options = parser.parse_args()
    if min(options.sequences, options.poses) < 1 or options.seed < 0:
        parser.error("sequences and poses are 1 or more, the seed is not negative")
    found = campaign(options.arm, options.sequences, options.poses, options.seed, campaign_runner(options))
    print(json.dumps(found, indent=2))
    return 0 if found["in_bounds"] else 1


if __name__ == "__main__":
    sys.exit(main())
