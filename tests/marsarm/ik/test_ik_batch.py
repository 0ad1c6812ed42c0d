"""Batches of inverse kinematics: answered, or refused with the row."""

import io
import json
import os
import signal
import subprocess
import sys
import time
import zipfile
from contextlib import suppress

import numpy as np
import pytest

from fsw.kinematics.closed_form import BRANCHES
from fsw.kinematics.ik import BranchVerdict
from marsarm.ik.batch import read_targets
from marsarm.ik.solve import BATCH_SIZE
from marsarm.ik.targets import VERDICT_NAMES
from sim.frames import approach_from, random_targets
from simgap.common.errors import BadRequest
from tests.marsarm.command import ROOT, marsarm
from tests.marsarm.ik.batch import P_M, A, expected, save, solved


def test_a_file_of_arrays_holds_every_answer_to_every_target(tmp_path):
    save(tmp_path / "in.npz")
    solved(tmp_path / "in.npz", tmp_path / "out.npz", tool="mahli", tilt_roll_deg=10.0)
    answers = expected(tool="mahli", tilt_roll_deg=10.0)
    with np.load(tmp_path / "out.npz", allow_pickle=False) as file:
        angles = answers.output_rad.transpose(2, 1, 0)
        assert np.allclose(file["output_rad"], angles, atol=1e-9, equal_nan=True)
        assert np.array_equal(file["verdict"], answers.verdict.T)
        assert file["output_rad"].shape == (4, 8, 5)
        assert tuple(file["branch_names"]) == BRANCHES
        assert tuple(file["verdict_names"]) == VERDICT_NAMES
        outside = file["verdict"] == BranchVerdict.OUTSIDE_LIMITS
        assert np.all((file["joint"] >= 0) == outside)
        assert np.all(file["excess"][outside] > 0.0)
        assert file["forward_error"][file["verdict"] == BranchVerdict.VALID].max() < 1e-8
        assert json.loads(str(file["about"]))["tilt_roll_deg"] == 10.0


def test_targets_beyond_one_part_are_answered_as_if_they_were_alone(tmp_path):
    p_m, angles = random_targets(np.random.default_rng(3), BATCH_SIZE + 2)
    approach = approach_from(angles).T
    save(tmp_path / "in.npz", p_m.T, approach)
    report = solved(tmp_path / "in.npz", tmp_path / "out.npz")
    assert report.tally.targets == BATCH_SIZE + 2
    alone = expected(p_m.T[BATCH_SIZE:], approach[BATCH_SIZE:])
    with np.load(tmp_path / "out.npz") as file:
        assert file["verdict"].shape[0] == BATCH_SIZE + 2
        assert np.array_equal(file["verdict"][BATCH_SIZE:], alone.verdict.T)


def test_the_same_targets_give_the_same_bytes(tmp_path):
    save(tmp_path / "in.npz")
    first, second = tmp_path / "first.npz", tmp_path / "second.npz"
    solved(tmp_path / "in.npz", first)
    solved(tmp_path / "in.npz", second)
    assert first.read_bytes() == second.read_bytes()


def test_a_summary_for_programs_and_for_people(tmp_path):
    save(tmp_path / "in.npz")
    words = ("ik", "--batch", "in.npz", "--out", "out.npz", "--tool", "portion")
    done = marsarm(tmp_path, *words, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    document = json.loads(done.stdout)
    assert document["targets"] == 4
    assert sum(document["targets_by_valid_branches"].values()) == pytest.approx(1.0)
    assert sum(document["out_by_verdict"].values()) == pytest.approx(1.0)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in.npz", document["out"]]
    done = marsarm(tmp_path, *words)  # replaces what was there
    assert done.returncode == 0, done.stderr
    for word in ("4 targets", "shoulder-out elbow-up wrist-up", "outside limits", "out.npz"):
        assert word in done.stdout


def test_an_output_through_a_link_replaces_the_file_and_not_the_link(tmp_path):
    save(tmp_path / "in.npz")
    (tmp_path / "real.npz").write_text("old")
    (tmp_path / "link.npz").symlink_to("real.npz")
    solved(tmp_path / "in.npz", tmp_path / "link.npz")
    assert (tmp_path / "link.npz").is_symlink()
    assert (tmp_path / "real.npz").stat().st_size > 1000


def changed(values, row, component, value):
    values = values.copy()
    values[row, component] = value
    return values


ARRAYS = {
    "NaN position": (changed(P_M, 2, 1, np.nan), A, "row 2 (the first is 0): position_m: 9 nan 0"),
    "infinite approach": (P_M, changed(A, 1, 0, np.inf), "row 1 (the first is 0): approach: inf"),
    "zero approach": (P_M, changed(A, 0, 2, 0.0), "row 0 (the first is 0): approach: 0 0 0 has no direction"),
    "far away": (changed(P_M, 3, 0, 1e300), A, "row 3 (the first is 0): position_m: 1e+300"),
    "lying": (P_M.T, A, "it must hold position_m, approach, each of shape (n, 3); it has position_m[0]"),
    "flat": (P_M[0], A[0], "it must hold position_m, approach, each of shape (n, 3); it has position_m"),
    "not as many": (P_M, A[:2], "there are 4 positions and 2 approaches"),
    "empty": (P_M[:0], A[:0], "has no rows"),
    "objects": (P_M.astype(object), A, "Object arrays cannot be loaded"),
    "text": (P_M.astype(str), A, "needs numbers"),
    "complex": (P_M + 1j, A, "array 'position_m' is complex128"),
}


@pytest.mark.parametrize("case", ARRAYS)
def test_bad_numbers_are_named_with_their_row_and_nothing_is_written(tmp_path, case):
    path, (*arrays, said) = tmp_path / "in.npz", ARRAYS[case]
    save(path, *arrays)
    with pytest.raises(BadRequest) as refused:
        solved(path, tmp_path / "out.npz")
    assert said in str(refused.value)
    assert list(tmp_path.iterdir()) == [path]


def no_numpy(path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("position_m", "abc")
        archive.writestr("approach.npy", "abc")


def enormous(path) -> None:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": "<f8", "fortran_order": False, "shape": (10**15, 3)}
    )
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("position_m.npy", header.getvalue())
        archive.writestr("approach.npy", header.getvalue())


def one_array(path) -> None:
    with path.open("wb") as file:
        np.save(file, P_M)


def other_names(path) -> None:
    np.savez(path, position=P_M, approach=A)


FOREIGN = {
    "text": ("in.npz", lambda path: path.write_text("hello"), "is no NumPy .npz file"),
    "one array": ("in.npz", one_array, "is no NumPy .npz file"),
    "another zip": ("in.npz", no_numpy, "cannot be read"),
    "more than there is memory": ("in.npz", enormous, "is too large for the memory"),
    "other names": (
        "in.npz",
        other_names,
        "each of shape (n, 3); it has position[",
    ),
    "another kind": ("in.csv", lambda path: path.touch(), "its name must end in .npz"),
}


@pytest.mark.parametrize("case", FOREIGN)
def test_a_foreign_file_is_refused(tmp_path, case):
    name, make, said = FOREIGN[case]
    make(tmp_path / name)
    with pytest.raises(BadRequest) as refused:
        read_targets(tmp_path / name, "rnav")
    assert said in str(refused.value)


def test_a_file_that_is_torn_or_overwritten_anywhere_is_refused_or_read_but_never_crashes(tmp_path):
    path = tmp_path / "in.npz"
    save(path)
    whole = path.read_bytes()
    for at in np.linspace(0, len(whole) - 1, 60).astype(int):
        path.write_bytes(whole[:at])
        with pytest.raises(BadRequest):
            read_targets(path, "rnav")
        path.write_bytes(whole[:at] + bytes(40) + whole[at + 40 :])
        with suppress(BadRequest):
            assert len(read_targets(path, "rnav")) == len(P_M)


def test_a_kill_leaves_nothing_behind(tmp_path):
    count = 50_000
    save(tmp_path / "in.npz", np.tile(P_M[0], (count, 1)), np.tile(A[0], (count, 1)))
    command = "from marsarm.__main__ import start; start()"
    run = subprocess.Popen(
        [sys.executable, "-c", command, "ik", "--batch", "in.npz", "--out", "out.npz"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    while run.poll() is None and not list(tmp_path.glob(".*.part")):
        time.sleep(0.01)
    run.send_signal(signal.SIGTERM)
    assert run.wait(60) == 128 + signal.SIGTERM
    assert [path.name for path in tmp_path.iterdir()] == ["in.npz"]
