"""Curves beside the scene of a view."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fsw.dictionary.enums import Joint
from fsw.kinematics.transforms import Array
from marsarm.view.frames import Frames


@dataclass(frozen=True, slots=True, eq=False)
class Plot:
    """Curves of one unit over the time of the frames."""

    title: str
    unit: str
    values: Mapping[str, Array]
    """Values of each curve by its label, shape (n,)."""


def make_plots(frames: Frames) -> tuple[Plot, ...]:
    """Make the plots of a run; those of the truth only if it is known."""
    samples = frames.samples
    plots = [Plot("joint angle", "deg", _by_joint(np.degrees(samples.believed_rad)))]
    if samples.true_rad is not None:
        plots.append(
            Plot(
                "true less believed angle", "mrad", _by_joint(1e3 * (samples.true_rad - samples.believed_rad))
            )
        )
    plots.append(Plot("motor current", "A", _by_joint(samples.current_A)))
    if samples.force_N is not None:
        plots.append(Plot("contact force", "N", {"": samples.force_N}))
    return tuple(plots)


def _by_joint(values: Array) -> dict[str, Array]:
    return {joint.name.lower(): values[joint] for joint in Joint}
