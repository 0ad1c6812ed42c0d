"""Random commands in the closed loop; `python -m validation commands` sends many more."""

import pytest

from validation.campaigns import Context
from validation.commands import campaign


@pytest.mark.parametrize("seed", [101, pytest.param(102, marks=pytest.mark.slow)])
def test_no_random_command_ends_flight_software_or_moves_anything_when_it_is_refused(seed):
    found = campaign(Context(seed), 1500)
    assert found["bugs"] == []
    assert found["cycles"] == 1500
    assert found["accepted"]
    assert sum(found["refused"].values()) > 300
