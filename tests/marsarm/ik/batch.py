"""Small batch of targets, as files and as results."""

import numpy as np

from marsarm.ik.request import IkRequest, ModelRequest
from marsarm.ik.solve import build_ik_model, solve
from marsarm.ik.targets import IkTargets
from sim.frames import p_R_from_N

P_M = np.array([[2.1, 0.0, -0.3], [2.0, 0.2, -0.1], [9.0, 0.0, 0.0], [1.9, -0.3, 0.1]])
A = np.array([[0.0, 0.0, 1.0], [0.5, 0.1, 0.8], [1.0, 0.0, 0.0], [1.0, 1.0, 1.0]])


def save(path, position_m=P_M, approach=A) -> None:
    """Write a batch."""
    np.savez(path, position_m=position_m, approach=approach)


def solved(batch, out, **model):
    """Solve a batch."""
    return solve(IkRequest(ModelRequest(**model), batch=batch, out=out), lambda *_: None)


def expected(position_m=P_M, approach=A, **model):
    """Compute the results directly with the kinematics, shape (S, n)."""
    unit = approach / np.linalg.norm(approach, axis=1)[:, None]
    targets = IkTargets(p_R_from_N(position_m).T, unit.T)
    return build_ik_model(ModelRequest(**model)).solve(targets)
