"""Numbers in sentences."""

from ground.render.words import counted


def test_one_is_one_and_all_else_is_many() -> None:
    assert [counted(n, "channel") for n in (0, 1, 2)] == ["0 channels", "1 channel", "2 channels"]
