"""Request for a diagnosis: folders are listed, and bad input is refused before a log is read."""

import pytest

from marsarm.diagnosis.arm.diagnose_logs import prepare_diagnosis
from marsarm.diagnosis.arm.request import DiagnoseRequest
from sim.effects.catalogue import catalogue
from simgap.common.errors import BadRequest


@pytest.fixture
def folder(tmp_path):
    """Create two empty logs, and one elsewhere."""
    (tmp_path / "logs").mkdir()
    for name in ("b", "a"):
        (tmp_path / "logs" / f"{name}.mcap").write_text(name)
    (tmp_path / "logs" / "a.tracker.csv").write_text("")
    (tmp_path / "other.mcap").write_text("other")
    return tmp_path


def test_a_folder_is_all_logs_in_it(folder):
    request = prepare_diagnosis(DiagnoseRequest((folder / "logs",), (folder / "other.mcap",)))
    assert [path.name for path in request.logs] == ["a.mcap", "b.mcap"]
    assert [path.name for path in request.held_out] == ["other.mcap"]
    assert request.kinds is None


def test_effects_are_named_in_any_order(folder):
    request = prepare_diagnosis(
        DiagnoseRequest((folder / "logs",), catalogue="gear-stiffness, coulomb-friction,gear-stiffness")
    )
    assert sorted(request.kinds) == ["coulomb-friction", "gear-stiffness"]
    assert list(request.kinds) == [name for name in catalogue() if name in request.kinds]


def test_what_is_held_out_takes_no_part_in_fitting(folder):
    (folder / "copy.mcap").write_text("a")
    for held_out in ("logs/a.mcap", "copy.mcap", "logs"):
        with pytest.raises(BadRequest, match=r"held-out log .* is log .*a\.mcap too"):
            prepare_diagnosis(DiagnoseRequest((folder / "logs",), (folder / held_out,)))


def test_no_log_counts_as_its_own_repeat(folder):
    with pytest.raises(BadRequest, match="is the same as"):
        prepare_diagnosis(DiagnoseRequest((folder / "logs", folder / "logs" / "a.mcap")))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"catalogue": "sensor-fault"}, "sensor-fault is an effect"),
        ({"campaign": "none"}, "campaign .*none: there is no such folder"),
        ({"held_out": ["none.mcap"]}, "held-out log .*none.mcap: there is no such file or folder"),
        ({"held_out": ["n" * 300]}, "there is no such file or folder"),
        ({"held_out": ["/dev/null"]}, "held-out log /dev/null: this is neither a regular file nor a folder"),
    ],
)
def test_what_is_wrong_is_refused(folder, options, said):
    if "campaign" in options:
        options = {"campaign": folder / options["campaign"]}
    if "held_out" in options:
        options = {"held_out": tuple(folder / path for path in options["held_out"])}
    with pytest.raises(BadRequest, match=said):
        prepare_diagnosis(DiagnoseRequest((folder / "logs",), **options))


def test_a_folder_without_logs_is_refused(folder):
    (folder / "empty").mkdir()
    with pytest.raises(BadRequest, match=r"log .*empty: this folder holds no \.mcap file"):
        prepare_diagnosis(DiagnoseRequest((folder / "empty",)))
