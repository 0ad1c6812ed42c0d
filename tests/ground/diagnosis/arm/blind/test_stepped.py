"""A plant that is stepped at rest says what statics say, of effects that statics know."""

import numpy as np

from fsw.dictionary.enums import Frame, Joint
from ground.diagnosis.arm.blind.stepped import change
from ground.diagnosis.arm.campaign import compared, predicted_values
from ground.diagnosis.arm.logs import Recording
from ground.diagnosis.arm.simulator import BRIEFLY
from sim.effects.joints import ResolverBias
from sim.effects.links import LinkLength
from sim.params import nominal_params

BASE = nominal_params()


def test_it_agrees_with_statics(recordings: list[Recording]) -> None:
    campaign = compared(recordings[:1])
    for effect in (LinkLength(Frame.ARM3, "x", 1e-3), ResolverBias(Joint.ELBOW, 1e-3)):
        said = predicted_values(campaign, (effect,), BRIEFLY)
        said = said - predicted_values(campaign, (), BRIEFLY)
        np.testing.assert_allclose(change(campaign, (effect,), BRIEFLY), said, atol=2e-5)
