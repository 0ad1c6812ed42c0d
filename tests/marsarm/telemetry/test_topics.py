"""Every field of a cycle has a topic in the log, also fields that are added later."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from marsarm.telemetry.topics import topics_in
from sim.record import CycleRecord


@dataclass(frozen=True, slots=True, eq=False)
class Arm:
    angle_rad: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Outputs:
    arm: Arm
    spare_arm: Arm | None
    alive: bool
    events: tuple[Arm, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Cycle:
    tick: int
    outputs: Outputs


def test_each_dataclass_in_a_cycle_is_a_topic_and_so_are_plain_fields_beside_them() -> None:
    assert [(t.name, t.path, t.field_names) for t in topics_in(Cycle)] == [
        ("/outputs", "outputs", ("alive",)),
        ("/arm", "outputs.arm", ("angle_rad",)),
        ("/spare_arm", "outputs.spare_arm", ("angle_rad",)),
    ]


def test_the_topics_of_our_cycle_have_names_of_their_own() -> None:
    names = [topic.name for topic in topics_in(CycleRecord)]
    assert {"/sensors", "/drive", "/joint", "/tool", "/truth"} <= set(names)
    assert len(set(names)) == len(names)
    assert not {"/evr", "/command"} & set(names)
