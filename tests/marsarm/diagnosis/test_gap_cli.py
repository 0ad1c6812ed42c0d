"""Errors of `gap record` and of the campaign of blind cases."""

from pathlib import Path
from typing import Any

import pytest

from simgap.common.errors import BadRequest
from validation.campaigns import Context
from validation.cases.arm import campaign


@pytest.mark.parametrize(
    ("out", "sizes", "said"),
    [
        ("b", {"cases": 0}, "cases: 0 is not within 1 .. 1000"),
        ("b", {"step": "dance"}, "step: dance is none of all, make, solve, score"),
        ("no/b", {}, "there is no folder .*no"),
        ("nothing", {}, "a link to nowhere/x, which is not there"),
        ("other", {}, "holds something else"),
        ("other/file", {}, "this is a file"),
        ("other", {"step": "solve"}, "no folder of cases"),
        ("other", {"step": "score"}, "no folder of cases"),
    ],
)
def test_cases_that_cannot_be_made_are_refused_and_nothing_is_written(
    tmp_path: Path, out: str, sizes: dict[str, Any], said: str
) -> None:
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "file").write_text("")
    (tmp_path / "nothing").symlink_to("nowhere/x")
    with pytest.raises(BadRequest, match=said):
        campaign(Context(out=tmp_path / out), **sizes)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "nothing", "other"]
