"""Targets computed from joint vectors, many of them next to double roots, and checks of their results."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.kinematics.arm import limit_excess
from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.ik import SAME_RAD as TWICE_RAD
from fsw.kinematics.ik import BranchVerdict, IkResult, describe_slot, inverse_kinematics
from fsw.kinematics.transforms import wrap_angle
from tests.fsw.rig import MARS_R_m_s2, config_of, in_limits
from tests.tools import tool_index
from validation import kinematics

GRAVITIES = {"rigid": None, "mars": MARS_R_m_s2, "tilted": np.array([0.9, -1.2, 3.4])}
DOUBLE_ROOT = kinematics.Near.ELBOW | kinematics.Near.WRIST | kinematics.Near.SHOULDER
INSIDE_RAD = 1e-6


@dataclass(frozen=True)
class SolvedTargets:
    """Targets, the joint vectors from which they were computed, and the result of the inverse kinematics."""

    trial: kinematics.Trial
    q: np.ndarray
    p: np.ndarray
    a: np.ndarray
    result: IkResult
    sigma: np.ndarray
    """Smallest singular value of the task Jacobian of the deflected tool."""

    @property
    def tolerance(self) -> float:
        return kinematics.RIGID_M if self.trial.gravity_R_m_s2 is None else kinematics.DEFLECTED_M


def trial_of(name: str, gravity: str, tool: str) -> kinematics.Trial:
    return kinematics.Trial(name, kinematics.arm_of(name), tool, GRAVITIES[gravity])


def solve_poses(trial: kinematics.Trial, q: np.ndarray) -> SolvedTargets:
    X = trial.tool_pose(q)
    p, a = X.p, X.R[:, 0]
    result = inverse_kinematics(trial.arm, trial.tool, p, a, trial.gravity_R_m_s2)
    return SolvedTargets(trial, q, p, a, result, kinematics.smallest_singular_value(trial, q))


@lru_cache
def random_poses(name: str, gravity: str, tool: str, n: int) -> SolvedTargets:
    """Solve targets of joint vectors anywhere inside the limits."""
    rng = np.random.default_rng(100 + tool_index(tool))
    return solve_poses(trial_of(name, gravity, tool), in_limits(config_of(), rng, n))


@lru_cache
def near_double_roots(name: str, gravity: str, tool: str, n: int) -> SolvedTargets:
    """Solve targets of joint vectors that are a microradian to a third of a radian from a double root."""
    trial, rng = trial_of(name, gravity, tool), np.random.default_rng([2264, tool_index(tool)])
    q, near = kinematics.draw_vectors(trial, rng, 9 * n)
    return solve_poses(trial, q[:, np.flatnonzero(near & DOUBLE_ROOT)[:n]])


def assert_poses_found(solved: SolvedTargets) -> None:
    """Assert that each regular pose is among its roots, and each that is found valid inside the limits."""
    distance = kinematics.root_distances(solved.result, solved.q)
    found, clear = distance.min(axis=0) < kinematics.SAME_RAD, kinematics.find_regular(solved.trial, solved.q)
    assert clear.any()
    lost = np.flatnonzero(clear & ~found)
    assert not lost.size, [(solved.q[:, k].tolist(), solved.sigma[k]) for k in lost[:3]]
    at = np.flatnonzero(found & (limit_excess(solved.trial.arm, solved.q).max(axis=0) < -INSIDE_RAD))
    assert (solved.result.verdict[distance.argmin(axis=0)[at], at] == BranchVerdict.VALID).all()


def assert_roots_meet(solved: SolvedTargets, bound_m: float, told: float = 2e-8) -> None:
    """Assert that every root meets its target, and that the result tells by how much."""
    there = kinematics.claimed_roots(solved.result)
    error = kinematics.root_errors(solved.trial, solved.result, solved.p, solved.a)[there]
    assert error.max() < bound_m
    np.testing.assert_allclose(solved.result.error[there], error, rtol=0, atol=told)


def assert_no_root_twice(result: IkResult) -> None:
    """Assert that any two roots of a target differ, modulo turns."""
    q = result.output_rad
    slots = np.arange(q.shape[1])
    distance = np.abs(wrap_angle(q[:, :, None] - q[:, None])).max(axis=0)
    distance[slots, slots] = np.inf
    assert np.nanmin(distance, initial=np.inf) > TWICE_RAD


def assert_consistent(arm, result: IkResult) -> None:
    """Assert what the docstring of IkResult states, for any target."""
    angles, verdict, excess = result.output_rad, result.verdict, result.excess
    assert verdict.shape == result.joint.shape == excess.shape == result.error.shape
    assert angles.shape == result.torque_Nm.shape == (5, *verdict.shape)
    assert verdict.shape[0] == len(BRANCHES)
    is_root = kinematics.claimed_roots(result)
    assert np.isfinite(angles[:, is_root]).all()
    assert np.isnan(angles[:, ~is_root]).all()
    assert np.isfinite(result.torque_Nm).all()
    assert not result.torque_Nm[:, ~is_root].any()
    assert np.isfinite(result.error[is_root]).all()
    over = limit_excess(arm, angles)
    assert (over[:, verdict == BranchVerdict.VALID] <= 0).all()
    out = is_root & (verdict == BranchVerdict.OUTSIDE_LIMITS)
    np.testing.assert_array_equal(excess[out], over[:, out].max(axis=0))
    np.testing.assert_array_equal(result.joint[out], over[:, out].argmax(axis=0))
    assert np.isfinite(excess).all()
    assert (excess >= 0).all()
    assert (excess[np.isin(verdict, (BranchVerdict.OUTSIDE_LIMITS, BranchVerdict.OUT_OF_REACH))] > 0).all()
    assert not excess[verdict == BranchVerdict.VALID].any()
    at_fault = result.joint[verdict == BranchVerdict.SINGULAR]
    assert np.isin(at_fault, (Joint.AZIMUTH, Joint.ELBOW, Joint.WRIST)).all()


def assert_sentences(arm, result: IkResult) -> None:
    """Assert that the sentences about a single target begin with the branch and have finite numbers."""
    for slot, name in enumerate(BRANCHES):
        sentence = describe_slot(arm, result, slot)
        assert sentence.startswith(f"{name}: ")
        assert "nan" not in sentence
        assert "inf" not in sentence
