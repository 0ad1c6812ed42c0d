"""What the campaign of tool changes demands."""

import pytest

from validation.tool_change import NotChanged, ToolChangeErrors, summary, tool_changes_in_bounds

NEAR = ToolChangeErrors(from_spot_mm=1.0, absolute_mm=3.0, named_mm=0.0)
NEAR_TOLD = ToolChangeErrors(from_spot_mm=0.5, absolute_mm=3.0, named_mm=2.9)
FAR_TOLD = ToolChangeErrors(from_spot_mm=4.0, absolute_mm=3.0, named_mm=7.9)
FAR_TOLD_TOO_MUCH = ToolChangeErrors(from_spot_mm=4.0, absolute_mm=3.0, named_mm=8.1)
FAR_UNTOLD = ToolChangeErrors(from_spot_mm=4.0, absolute_mm=3.0, named_mm=0.0)
TOO_FAR = ToolChangeErrors(from_spot_mm=10.1, absolute_mm=3.0, named_mm=11.0)


@pytest.mark.parametrize(
    ("others", "is_in_bounds"),
    [
        ([NEAR] * 3, True),
        ([FAR_TOLD, NEAR_TOLD, NEAR_TOLD], True),
        ([FAR_TOLD, NEAR_TOLD], False),  # the median of 2.9 and 7.9 mm
        ([FAR_TOLD] * 4 + [NEAR_TOLD] * 5, False),  # four of 66 are far
        ([FAR_UNTOLD, NEAR, NEAR], False),
        ([FAR_TOLD_TOO_MUCH, NEAR_TOLD, NEAR_TOLD], False),
        ([TOO_FAR, NEAR_TOLD, NEAR_TOLD], False),
        ([NotChanged("not completed", "mahli lost contact")] * 3, True),
        ([NotChanged("not completed", "mahli lost contact")] * 4, False),
        ([NotChanged("refused", "no way")] * 11, False),
        ([NotChanged("refused", "no way", reachable=False)] * 11, True),
    ],
)
def test_changes_end_near_the_spot_or_are_told_and_few_fail(others, is_in_bounds):
    assert tool_changes_in_bounds([NEAR] * 57 + others) is is_in_bounds


def test_changes_that_are_neither_near_nor_told_are_listed():
    found = summary([NEAR, FAR_TOLD, FAR_UNTOLD, FAR_TOLD_TOO_MUCH])
    assert (found["near"], found["named"], found["named_median_mm"]) == (1, 2, 8.0)
    assert [one["named_mm"] for one in found["neither_near_nor_told"]] == [0.0, 8.1]
