"""Pseudo-Huber loss: the square of small residuals, twice the absolute value of large ones."""

import numpy as np

from simgap.arrays import Array


def pseudo_huber(z: Array) -> Array:
    """Compute the loss: the square of small residuals, twice the absolute value of large ones.

    Args:
        z: Residuals over their scale, (n,), unitless.

    Returns:
        Losses, (n,).
    """
    square = z * z
    loss: Array = 2.0 * square / (np.sqrt(1.0 + square) + 1.0)  # exact for small residuals too
    return loss


def half_loss_derivatives(z: Array) -> tuple[Array, Array]:
    """Compute the first two derivatives of half the pseudo-Huber loss.

    Args:
        z: Residuals over their scale, (n,), unitless.

    Returns:
        Slope and curvature, (n,) each.
    """
    return z / np.sqrt(1.0 + z * z), (1.0 + z * z) ** -1.5


def root_weight(z: Array) -> Array:
    """Compute the weights with which a sum of squares acts as the pseudo-Huber loss near these residuals.

    Args:
        z: Residuals over their scale, (n,), unitless.

    Returns:
        Square roots of the weights of the squares, (n,).
    """
    weight: Array = (1.0 + z * z) ** -0.25
    return weight
