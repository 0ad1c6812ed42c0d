"""Boulder for pictures: an ellipsoid, chipped by planes, with one face where the arm touches it.

It is looks only: the contact is a disc in its face. The same shape is made each time.
"""

from typing import Final

import numpy as np

from fsw.kinematics.transforms import Array

RINGS: Final = 28
SECTORS: Final = 56
"""At 0.2 m from the centre, a triangle is 2 cm wide: chips and edges show in pictures 1,300 pixels wide."""
CHIPS: Final = 40
"""Number of planes; with fewer the boulder looks cut, with many more it is an egg."""
DEPTH: Final = (0.80, 1.0)
"""Distances of the planes from the centre, as shares of the radius."""
ROUGHNESS: Final = 0.02
SEED: Final = 6


def boulder(half_m: Array, face_m: Array, normal: Array) -> tuple[Array, Array]:
    """Return vertices, shape (n, 3), and faces, shape (m, 3), of a boulder around the origin.

    Args:
        half_m: Half axes of the ellipsoid, shape (3,).
        face_m: Point of the face, shape (3,).
        normal: Unit vector out of the face, shape (3,); the origin is behind the face.
    """
    polar = np.linspace(0.0, np.pi, RINGS + 1)
    turn = np.arange(SECTORS) * 2 * np.pi / SECTORS
    x, y = (np.outer(np.sin(polar), f(turn)) for f in (np.cos, np.sin))
    unit = np.stack([x, y, np.broadcast_to(np.cos(polar)[:, None], x.shape)], axis=-1).reshape(-1, 3)
    rng = np.random.default_rng(SEED)
    planes = rng.normal(size=(CHIPS, 3))
    planes /= np.linalg.norm(planes, axis=1)[:, None] * rng.uniform(*DEPTH, (CHIPS, 1))
    nearest = np.maximum(unit @ planes.T, 0.0).max(axis=1)
    rough = 1.0 + ROUGHNESS * rng.uniform(-1.0, 1.0, (RINGS + 1, SECTORS))
    rough[[0, -1]] = 1.0  # the poles are one point each
    along = unit * half_m * (rough.ravel() / np.maximum(nearest, 1.0))[:, None]
    beyond = (along @ normal) / float(face_m @ normal)
    return along / np.maximum(beyond, 1.0)[:, None], _faces()


def _faces() -> Array:
    index = np.arange((RINGS + 1) * SECTORS).reshape(RINGS + 1, SECTORS)
    a, b = index[:-1], index[1:]
    c, d = (np.roll(rows, -1, axis=1) for rows in (b, a))
    upper, lower = np.stack([a, b, c], axis=-1)[:-1], np.stack([a, c, d], axis=-1)[1:]
    return np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)])
