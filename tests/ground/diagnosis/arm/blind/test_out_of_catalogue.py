"""At rest, the simulated plant agrees with statics for effects that statics include."""

import numpy as np
import pytest

from fsw.dictionary.enums import Frame, Joint
from ground.diagnosis.arm.feature_set import build_feature_set, simulate_features
from ground.diagnosis.arm.logs import Recording
from ground.diagnosis.arm.simulator import SHORT_SETTLING
from sim.effects.joints import ResolverBias
from sim.effects.links import LinkLength
from sim.params import nominal_params
from validation.blind.out_of_catalogue import change

BASE = nominal_params()


@pytest.mark.slow
def test_it_agrees_with_statics(recordings: list[Recording]) -> None:
    campaign = build_feature_set(recordings[:1])
    for effect in (LinkLength(Frame.ARM3, "x", 1e-3), ResolverBias(Joint.ELBOW, 1e-3)):
        said = simulate_features(campaign, (effect,), SHORT_SETTLING)
        said = said - simulate_features(campaign, (), SHORT_SETTLING)
        np.testing.assert_allclose(change(campaign, (effect,), SHORT_SETTLING), said, atol=2e-5)
