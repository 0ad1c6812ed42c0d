"""Text of the console."""

from simgap.common.console import pluralize


def test_one_is_one_and_all_else_is_many() -> None:
    assert [pluralize(n, "channel") for n in (0, 1, 2)] == ["0 channels", "1 channel", "2 channels"]
