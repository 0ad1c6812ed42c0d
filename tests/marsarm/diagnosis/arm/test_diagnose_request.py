"""Request for a diagnosis: folders are listed, and bad input is refused before a log is read."""

import pytest

from marsarm.diagnosis.arm.diagnose_logs import diagnose, expand_logs
from marsarm.diagnosis.arm.request import DiagnoseRequest
from simgap.common.errors import BadRequest


@pytest.fixture
def folder(tmp_path):
    """Create two empty logs, and one elsewhere."""
    (tmp_path / "logs").mkdir()
    for name in ("b", "a"):
        (tmp_path / "logs" / f"{name}.mcap").write_text(name)
    (tmp_path / "logs" / "a.tracker.csv").write_text("")
    (tmp_path / "other.mcap").write_text("other")
    (tmp_path / "empty").mkdir()
    return tmp_path


def test_a_folder_is_all_logs_in_it(folder):
    logs = expand_logs((folder / "logs", folder / "other.mcap"), "log")
    assert [path.name for path in logs] == ["a.mcap", "b.mcap", "other.mcap"]


@pytest.mark.parametrize(
    ("logs", "held_out", "options", "said"),
    [
        (["empty"], [], {}, r"log .*empty: this folder holds no \.mcap file"),
        (["logs"], ["n" * 300], {}, "there is no such log or folder"),
        (["logs"], ["/dev/null"], {}, "held-out log /dev/null: there is no such log"),
        (["logs"], [], {"catalogue": "sensor-fault"}, "'sensor-fault' is no effect"),
        (["logs"], [], {"campaign": "none"}, "campaign .*none: there is no such folder"),
    ],
)
def test_what_is_wrong_is_refused(folder, logs, held_out, options, said):
    paths = [tuple(folder / path for path in some) for some in (logs, held_out)]
    options = {name: folder / text if name == "campaign" else text for name, text in options.items()}
    with pytest.raises(BadRequest, match=said):
        diagnose(DiagnoseRequest(*paths, **options))
