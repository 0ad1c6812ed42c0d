"""Results of a campaign that was interrupted: what is done is not done again."""

from pathlib import Path

import pytest

from simgap.common.errors import BadRequest
from validation import resumable
from validation.resumable import keep_results


def test_a_campaign_goes_on_after_its_last_result(tmp_path: Path) -> None:
    done: list[str] = []

    def work(name: str) -> dict[str, str]:
        done.append(name)
        return {"found": name}

    for names in (["one", "two"], ["one", "two", "three"]):
        with keep_results(tmp_path / "results.jsonl", 1) as once:
            found = [once(name, lambda name=name: work(name)) for name in names]
    assert found == [{"found": "one"}, {"found": "two"}, {"found": "three"}]
    assert done == ["one", "two", "three"]


def test_results_of_other_code_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with keep_results(tmp_path / "results.jsonl", 1) as once:
        once("one", dict)
    monkeypatch.setattr(resumable, "digest_code", lambda: "another")
    with (
        pytest.raises(BadRequest, match="code of the diagnosis"),
        keep_results(tmp_path / "results.jsonl", 1),
    ):
        pass


def test_without_a_file_nothing_is_kept() -> None:
    with keep_results(None, 1) as once:
        assert once("one", lambda: {"n": 1}) == {"n": 1}
