"""A resolver against what its encoder, and the gear between them, say of the output."""

import numpy as np
import pytest

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Joint, Mode
from fsw.dictionary.faults import ResolverDisagrees
from tests.fsw.executive.faults.lab import BOUNDS, CONFIG, REFUSED, START, found, moving, resolver_off
from tests.fsw.rig import Rig, alive


@pytest.mark.parametrize("joint", Joint)
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("start", [moving, lambda: Rig(CONFIG, start_rad=START)], ids=["moving", "resting"])
def test_a_resolver_may_be_off_by_its_bound_and_what_is_unknown_of_the_gap_and_no_more(joint, sign, start):
    for more_rad, said in ((-2e-4, False), (2e-4, True)):
        rig = start()
        for _ in range(300):
            bound = BOUNDS.resolver_error_rad + rig.state.joints.uncertainty_rad[joint]
            rig.cycle(**resolver_off(rig, joint, sign * (bound + more_rad)))
        assert bool(found(rig, ResolverDisagrees)) is said
        if said:
            (evr,) = found(rig, ResolverDisagrees)
            assert evr.joint is joint
            assert sign * evr.error_rad > evr.bound_rad >= BOUNDS.resolver_error_rad
            assert REFUSED in rig.evrs
            assert rig.state.mode is Mode.FAULTED


@pytest.mark.parametrize("joint", Joint)
def test_a_resolver_that_reads_wrong_for_less_than_its_persistence_is_no_fault(joint):
    rig = moving()
    for _ in range(3):
        for _ in range(BOUNDS.resolver_persistence // 2):
            rig.cycle(**resolver_off(rig, joint, 0.01))
        for _ in range(2 * CYCLE_HZ):
            rig.cycle()
    assert not found(rig, ResolverDisagrees)


def test_a_resolver_of_a_joint_that_is_not_calibrated_disagrees_with_nothing():
    rig = Rig(CONFIG, start_rad=START, calibrated=False)
    rig.cycle()
    for k in range(3 * BOUNDS.resolver_persistence):
        rig.cycle(resolver_rad=np.full(5, 1.0 + alive(k)))
    assert not found(rig, ResolverDisagrees)
