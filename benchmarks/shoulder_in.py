"""The paper's Figure 7: where joints fall to the other side of their gap, predictions without it are off.

Four groups of forty poses over the workspace, on Earth, with stand-in turrets of 8 and 19 kg, level and
rolled by 20 degrees, shoulder-out poses first and then 30 % shoulder-in. The drill's place is predicted from
the encoders after hardstop initialisation: once as if every joint still lay on the side of its gap where it
was pressed against its hardstop, once with the state that flight software believes.
"""

import argparse
import json
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

import numpy as np

from fsw.config import Config, configure
from fsw.dictionary.joints import Tool
from fsw.kinematics.answers import Verdict
from fsw.kinematics.branches import BRANCHES
from fsw.kinematics.chain import tool_pose
from fsw.kinematics.ik import inverse_kinematics
from fsw.kinematics.statics import rest, settle
from fsw.kinematics.transforms import Array
from sim.arms import BuiltArm, arm_named
from sim.effects.turret import TurretMass
from sim.frames import p_R_from_N
from sim.initialisation import initialised
from sim.params import digest
from sim.tour import Settled, tour
from sim.workspace import approach_from, random_targets
from sim.world import World

EXAMPLE = "example: python -m benchmarks.shoulder_in --picture docs/shoulder-in.png"
GROUPS: Final = ((8.0, 0.0), (8.0, 20.0), (19.0, 0.0), (19.0, 20.0))
"""Mass of the stand-in turret [kg], roll of the rover [deg]."""
POSES: Final = 40
SHOULDER_IN: Final = 12
INSIDE_RAD: Final = 0.05


@dataclass(frozen=True, slots=True)
class Predicted:
    """How far the drill was from where it was predicted, and how many joints had fallen to the other side."""

    shoulder_in: bool
    as_initialised_mm: float
    with_state_mm: float
    fallen: int


def standing_in(mass_kg: float) -> BuiltArm:
    """The nominal arm with a stand-in turret, which flight software knows."""
    turret, nominal = TurretMass(mass_kg), arm_named("nominal")
    return replace(nominal, effects=(*nominal.effects, turret), params=turret.on_params(nominal.params))


def group(index: int, seed: int) -> list[Predicted]:
    """One group of poses, shoulder-out and then shoulder-in."""
    mass_kg, roll_deg = GROUPS[index]
    arm = standing_in(mass_kg)
    world = World("earth", tilt_roll_rad=float(np.radians(roll_deg)))
    config = configure(arm.params, digest(arm.params))
    rng = np.random.default_rng([seed, index, 6])
    goals = [pose_on(config, rng, k >= POSES - SHOULDER_IN) for k in range(POSES)]
    reference = list(initialised(arm_named("nominal"), seed=seed))[-1].reference
    settled = tour(arm, reference, world, goals, "off", seed)
    return [_predicted(config, s, k >= POSES - SHOULDER_IN) for k, s in enumerate(settled)]


def predictions(seed: int, workers: int) -> list[list[Predicted]]:
    """All groups."""
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        return list(pool.map(group, range(len(GROUPS)), [seed] * len(GROUPS)))


def pose_on(config: Config, rng: np.random.Generator, shoulder_in: bool) -> Array:
    """A pose at a random target of the workspace on a random valid branch with that shoulder."""
    while True:
        p_N_m, angles = random_targets(rng, 1)
        approach = approach_from(angles)[:, 0]
        answers = inverse_kinematics(
            config.arm, Tool.DRILL, p_R_from_N(p_N_m[:, 0]), approach, np.zeros(3), np.zeros(5)
        )
        wanted = [name.startswith("shoulder-in") == shoulder_in for name in BRANCHES]
        low, high = config.arm.soft_min_rad + INSIDE_RAD, config.arm.soft_max_rad - INSIDE_RAD
        for slot in rng.permutation(len(BRANCHES)):
            pose = answers.output_rad[:, slot]
            if (
                wanted[slot]
                and answers.verdict[slot] == Verdict.VALID
                and np.all((low < pose) & (pose < high))
            ):
                return np.asarray(pose)


def _predicted(config: Config, s: Settled, shoulder_in: bool) -> Predicted:
    pressed = settle(config.arm, s.motor_rad, config.half_gap_rad, s.gravity_R_m_s2)
    believed = rest(config.arm, s.motor_rad + s.believed_gear_rad, s.gravity_R_m_s2)
    off = [
        1e3 * float(np.linalg.norm(tool_pose(config.arm, pose.frames, Tool.DRILL).p - s.p_RoTo_R_m))
        for pose in (pressed, believed)
    ]
    return Predicted(shoulder_in, off[0], off[1], int(np.count_nonzero(s.true_side < 0)))


def document(groups: Sequence[Sequence[Predicted]]) -> dict[str, Any]:
    """The means that the picture shows."""
    every = [p for poses in groups for p in poses]
    return {
        "poses": len(every),
        **{
            name: {
                "as_initialised_mm": _mean([p.as_initialised_mm for p in every if p.shoulder_in == inside]),
                "with_state_mm": _mean([p.with_state_mm for p in every if p.shoulder_in == inside]),
                "fallen_joints": _mean([p.fallen for p in every if p.shoulder_in == inside]),
            }
            for name, inside in (("shoulder_out", False), ("shoulder_in", True))
        },
    }


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))


def draw(groups: Sequence[Sequence[Predicted]], path: Path) -> None:
    """Both predictions over the poses, as in the paper's figure."""
    os.environ.pop("MPLBACKEND", None)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    every = [p for poses in groups for p in poses]
    number = np.arange(1, len(every) + 1)
    for k in range(len(groups)):
        first = k * POSES + POSES - SHOULDER_IN + 0.5
        axes.axvspan(first, first + SHOULDER_IN, color="0.92", label="shoulder-in" if k == 0 else None)
        mass_kg, roll_deg = GROUPS[k]
        axes.text(
            k * POSES + 1,
            0.97,
            f"{mass_kg:g} kg, roll {roll_deg:g} deg",
            va="top",
            fontsize=8,
            transform=axes.get_xaxis_transform(),
        )
    axes.plot(
        number,
        [p.as_initialised_mm for p in every],
        ".-",
        color="#c1121f",
        linewidth=0.6,
        label="gaps taken to be as at the hardstop",
    )
    axes.plot(
        number,
        [p.with_state_mm for p in every],
        ".-",
        color="#31688e",
        linewidth=0.6,
        label="with the believed state of the backlash",
    )
    axes.set(
        xlabel="pose", ylabel="drill from its predicted place [mm]", xlim=(0, len(every) + 1), ylim=(0, None)
    )
    figure.legend(loc="outside lower center", ncols=3, fontsize=9)
    figure.savefig(path, dpi=110)


def main() -> int:
    """Print the means as JSON, and draw the picture."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.shoulder_in",
        description=__doc__,
        epilog=EXAMPLE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--picture", type=Path, help="where to draw it, .png")
    parser.add_argument("--workers", type=int, default=2, help="processes (default 2)")
    parser.add_argument("--seed", type=int, default=0, help="of everything random (default 0)")
    asked = parser.parse_args()
    groups = predictions(asked.seed, asked.workers)
    if asked.picture is not None:
        draw(groups, asked.picture)
    print(json.dumps(document(groups), indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
