"""How long the inverse kinematics takes, against EAIK and against forward kinematics, on one core.

Every ratio is the median of quotients of times measured one after the other; times alone are the machine's.
"""

import time
from collections.abc import Callable
from functools import partial
from statistics import median
from typing import Any, Final

import numpy as np

from fsw.dictionary.enums import Tool
from fsw.kinematics.chain import forward
from fsw.kinematics.ik import inverse_kinematics
from fsw.kinematics.transforms import Array
from validation.kinematics_trials import Trial, arm_of, claimed_roots
from validation.oracle import KINDS, Eaik, distinct_poses, interface_poses, random_targets

TARGETS: Final = 10_000
SINGLE: Final = 100
REPEATS: Final = 5
TOOL: Final = Tool.APXS
MARS_R_m_s2: Final = np.array([0.0, 0.0, 3.711])
RIGID: Final = Trial("nominal", arm_of("nominal"), TOOL, None)
ARMS: Final = ("nominal", "calibrated:3")


def kinematics_speed() -> dict[str, Any]:
    """Microseconds a target; all branches, with their limits and forward checks."""
    return {
        "rigid": {kind: _rigid(*random_targets(TOOL, kind, _rng(), TARGETS)) for kind in KINDS},
        "compensated": {f"{name}, {kind}": _compensated(name, kind) for name in ARMS for kind in KINDS},
    }


def _rng() -> np.random.Generator:
    return np.random.default_rng(11)


def _us(job: Callable[[], Any], count: int) -> float:
    """Microseconds of each of the things that the job does."""
    began = time.perf_counter()
    job()
    return 1e6 * (time.perf_counter() - began) / count


def _rigid(p_m: Array, approach: Array) -> dict[str, Any]:
    """A batch of targets, and the calls of EAIK that find the same roots of the same targets."""

    def ours() -> None:
        inverse_kinematics(RIGID.arm, TOOL, p_m, approach)

    try:
        eaik = Eaik()
    except ImportError:
        return {
            "us": median(_us(ours, TARGETS) for _ in range(REPEATS)),
            "eaik": "not installed, not measured",
        }
    poses = _poses(p_m, approach)

    def one_by_one() -> None:
        for X_1F in poses:
            solution = eaik.robot.IK(X_1F)
            solution.Q, solution.is_LS  # noqa: B018  the roots leave C++ when they are asked for

    def batched() -> None:
        eaik.robot.IK_batched(poses, 1)

    times = np.array([[_us(job, TARGETS) for job in (ours, one_by_one, batched)] for _ in range(REPEATS)])
    us = np.median(times, axis=0)
    return {
        "us": us[0],
        "eaik_calls_per_target": len(poses) / TARGETS,
        "eaik_us": us[1],
        "eaik_batched_us": us[2],
        "ratio_to_eaik": float(np.median(times[:, 0] / times[:, 1])),
        "ratio_to_eaik_batched": float(np.median(times[:, 0] / times[:, 2])),
    }


def _poses(p_m: Array, approach: Array) -> list[Array]:
    """The different full poses among the roots of each target, which EAIK has to be asked for."""
    answers = inverse_kinematics(RIGID.arm, TOOL, p_m, approach)
    there = claimed_roots(answers)
    poses = []
    for k in range(p_m.shape[1]):
        of_target = interface_poses(RIGID, answers.output_rad[:, there[:, k], k])
        poses += list(of_target[distinct_poses(of_target)])
    return poses


def _compensated(name: str, kind: str) -> dict[str, Any]:
    """On Mars: a batch, single targets one by one, and forward kinematics of as many poses for scale."""
    arm = arm_of(name)
    p_m, approach = random_targets(TOOL, kind, _rng(), TARGETS)
    q = _rng().uniform(arm.soft_min_rad[:, None], arm.soft_max_rad[:, None], (5, TARGETS))

    def batch() -> None:
        inverse_kinematics(arm, TOOL, p_m, approach, MARS_R_m_s2)

    def singles() -> list[float]:
        """Milliseconds of each: near double roots a target takes longer."""
        return [
            1e-3 * _us(partial(inverse_kinematics, arm, TOOL, p, a, MARS_R_m_s2), 1)
            for p, a in zip(p_m.T[:SINGLE], approach.T[:SINGLE], strict=True)
        ]

    batches_us, forwards_us, single_ms, single_forward_ms = [], [], [], []
    for _ in range(REPEATS):
        batches_us.append(_us(batch, TARGETS))
        forwards_us.append(_us(lambda: forward(arm, q), TARGETS))
        single_ms.append(singles())
        single_forward_ms.append(median(1e-3 * _us(lambda: forward(arm, q[:, 0]), 1) for _ in range(SINGLE)))
    typical_ms = [median(times) for times in single_ms]
    return {
        "batch_us": median(batches_us),
        "batch_ratio_to_forward": median(b / f for b, f in zip(batches_us, forwards_us, strict=True)),
        "single_ms": median(typical_ms),
        "single_p99_ms": float(np.percentile(np.median(single_ms, axis=0), 99)),
        "single_ratio_to_forward": median(s / f for s, f in zip(typical_ms, single_forward_ms, strict=True)),
    }
