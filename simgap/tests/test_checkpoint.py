"""Progress and kept steps of a diagnosis: the next run ends with the same bits, and takes no others."""

import os
import time
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from helpers.marks import slow_but
from helpers.planar_arm import planar_arm, slow_logs, with_joint
from helpers.toy import BASE, CATALOGUE, Toy, ToyResiduals, draw_toy
from simgap.arrays import Array
from simgap.selection.checkpoint import STEPS, Checkpoint, EXPIRED_s, Meter, find_steps, pack, unpack
from simgap.selection.selection import select_effects
from simgap.selection.verdict import find_confidence_sets

BODY = Toy("base", "square of all", np.square)
EFFECTS = (*CATALOGUE, BODY)
TRUTH = {"near: square": 0.1, "far: square": 0.1, "far: sine": 0.05}


class Killed(BaseException):
    """End of a run at once."""


class MortalToy(ToyResiduals):
    """Toy whose run is killed after a number of candidates."""

    last = 10**9

    def residuals(self, effects, sizes):
        if self.calls + len(sizes) > self.last:
            raise Killed
        return super().residuals(effects, sizes)


def mortal(last=10**9):
    toy = draw_toy(1, TRUTH, n_samples=60)
    model = MortalToy(toy.commands, toy.measured, toy.joints)
    model.last = last
    return model


def find(model, folder, meter=None):
    with Checkpoint(folder, EFFECTS) as checkpoint:
        selection = select_effects(model, BASE, EFFECTS, seed=1, meter=meter, checkpoint=checkpoint)
        return selection, find_confidence_sets(selection)


def bits(found):
    """Return every number of what was found."""
    selection, sets = found
    arrays: list[Array] = [selection.context.scales, selection.context.base_left_out]
    text = pack([selection.base, selection.chosen, sets], arrays)
    return [repr(text).encode(), *(array.tobytes() for array in arrays)]


@pytest.fixture(scope="module")
def whole():
    """The bits of a run that was not killed, the candidates that it took, and those that it may take twice.

    These are of its longest step and of all that is in no step.
    """
    model, steps, step = mortal(), [], Checkpoint.step

    def count(self, meter, name, work):
        before = model.calls
        found = step(self, meter, name, work)
        steps.append(model.calls - before)
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Checkpoint, "step", count)
        found = bits(find(model, None))
        return found, model.calls, max(steps) + model.calls - sum(steps)


@pytest.mark.parametrize("share", slow_but([0.02, 0.35, 0.65, 0.95], 0.65))
def test_a_run_that_was_killed_goes_on_and_ends_with_the_same_bits(whole, tmp_path, share):
    expected, calls, twice = whole
    with pytest.raises(Killed):
        find(mortal(int(share * calls)), tmp_path / "steps")
    second = mortal()
    assert bits(find(second, tmp_path / "steps")) == expected
    assert second.calls <= (1.0 - share) * calls + twice
    assert not (tmp_path / "steps").exists()


@pytest.mark.slow
def test_a_step_that_was_torn_is_carried_out_again(whole, tmp_path):
    expected, calls, _ = whole
    with pytest.raises(Killed):
        find(mortal(int(0.7 * calls)), tmp_path / "steps")
    steps = sorted((tmp_path / "steps").iterdir())
    for path, cut in ((steps[-1], 0), (steps[-2], 1), (steps[2], 500)):
        path.write_bytes(path.read_bytes()[:-cut] if cut else b"")
    assert bits(find(mortal(), tmp_path / "steps")) == expected


@pytest.mark.slow
def test_the_progress_goes_on_from_where_it_was(whole, tmp_path):
    shares: list[float] = []
    with pytest.raises(Killed):
        find(mortal(int(0.8 * whole[1])), tmp_path / "steps", Meter(lambda share, _: shares.append(share)))
    again: list[tuple[float, str]] = []
    find(mortal(), tmp_path / "steps", Meter(lambda share, text: again.append((share, text))))
    assert again[0][1] == "going on"
    assert again[0][0] == pytest.approx(shares[-1], abs=0.05)


def test_after_the_last_round_as_much_is_left_as_was_expected_after_it():
    shares: list[float] = []
    meter = Meter(lambda share, _: shares.append(share))
    meter.begin_round(100, 0.5)
    meter.advance("screening", 100)
    meter.end_rounds()
    meter.advance("fit", 25)
    assert shares == pytest.approx([100 / (110 + 50), 125 / (125 + 25)])


def test_an_error_leaves_no_steps_because_it_would_come_again(tmp_path):
    def fail():
        with Checkpoint(tmp_path / "steps") as checkpoint:
            checkpoint.step(Meter(), "one", lambda: np.ones(3))
            checkpoint.step(Meter(), "two", lambda: 1 / 0)

    with pytest.raises(ZeroDivisionError):
        fail()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_folder_that_cannot_be_made_stops_no_diagnosis(whole, tmp_path):
    (tmp_path / "file").write_text("")
    assert bits(find(mortal(), tmp_path / "file" / "steps")) == whole[0]


def test_a_full_disk_stops_no_diagnosis(whole, tmp_path, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    with pytest.raises(Killed):
        find(mortal(whole[1] // 2), tmp_path / "steps")
    monkeypatch.setattr(np, "savez", full)
    assert bits(find(mortal(), tmp_path / "steps")) == whole[0]
    assert list(tmp_path.iterdir()) == []


def test_steps_that_nobody_went_on_from_for_a_week_are_deleted(tmp_path):
    names = [f"{STEPS}old", f"{STEPS}new", "results of the user"]
    for name, age_s in zip(names, (EXPIRED_s + 60.0, EXPIRED_s - 3600.0, 10 * EXPIRED_s), strict=True):
        (tmp_path / name).mkdir()
        os.utime(tmp_path / name, (time.time() - age_s,) * 2)
    Checkpoint(tmp_path / f"{STEPS}mine")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([f"{STEPS}mine", *names[1:]])


def test_a_step_that_contains_steps_is_recalled_as_one(tmp_path):
    for _ in range(2):
        checkpoint = Checkpoint(tmp_path / "steps")

        def outer(own=checkpoint):
            return [own.step(Meter(), "inner", lambda k=k: k) for k in range(3)]

        assert checkpoint.step(Meter(), "outer", outer) == [0, 1, 2]
        assert checkpoint.step(Meter(), "after", lambda: 7) == 7
    assert len(list((tmp_path / "steps").iterdir())) == 5


def test_only_records_of_the_diagnosis_are_made_from_a_file():
    names = {"os": "system", "simgap.selection.checkpoint": "Checkpoint", "dataclasses": "field"}
    for module, name in names.items():
        with pytest.raises(KeyError):
            unpack({"record": [module, name], "fields": []}, [], {})


def test_the_digest_changes_with_every_input():
    robot, logs = planar_arm(), slow_logs(planar_arm(), count=2)
    moved = with_joint(logs, "elbow", lambda log: replace(log, command=log.position))
    used = {("motion 0", "elbow"): np.array([True, False])}
    same = find_steps("cache", planar_arm(), slow_logs(planar_arm(), count=2).motions, (), None, (), 1)
    others = (
        find_steps("cache", planar_arm(table=True), logs.motions, (), None, (), 1),
        find_steps("cache", replace(robot, tool_site=""), logs.motions, (), None, (), 1),
        find_steps("cache", robot, moved.motions, (), None, (), 1),
        find_steps("cache", robot, logs.motions[:1], (), None, (), 1),
        find_steps("cache", robot, logs.motions[:1], logs.motions[1:], None, (), 1),
        find_steps("cache", robot, [replace(one, repeat_of="a") for one in logs.motions], (), None, (), 1),
        find_steps("cache", robot, logs.motions, (), used, (), 1),
        find_steps("cache", robot, logs.motions, (), {key: ~flags for key, flags in used.items()}, (), 1),
        find_steps("cache", robot, logs.motions, (), None, (BODY,), 1),
        find_steps("cache", robot, logs.motions, (), None, (), 2),
    )
    assert find_steps("cache", robot, logs.motions, (), None, (), 1) == same
    assert len({same, *others}) == 1 + len(others)


def test_the_digest_changes_with_the_code_and_an_effect_without_a_file_has_none(monkeypatch, tmp_path):
    kind = type("Typed", (Toy,), {"__module__": "typed"})
    assert find_steps("cache", planar_arm(), (), (), None, (kind("base", "x", np.square),), 1) is None
    before = find_steps("cache", planar_arm(), (), (), None, (), 1)
    (tmp_path / "fit.py").write_text("")
    monkeypatch.setattr("simgap.selection.checkpoint.PACKAGE", tmp_path)
    assert find_steps("cache", planar_arm(), (), (), None, (), 1) != before


TRUTHS = ({"near: square": 0.1}, {"near: square": 0.1, "far: sine": 0.05})


@pytest.mark.parametrize("truth", slow_but(TRUTHS, TRUTHS[1]))
def test_the_share_of_a_selection_is_never_far_from_that_of_its_candidates(truth):
    model = draw_toy(1, truth)
    reports: list[tuple[float, int]] = []
    meter = Meter(lambda share, text: reports.append((share, model.calls)))
    find_confidence_sets(select_effects(model, BASE, CATALOGUE, seed=1, meter=meter))
    assert all(before[0] <= after[0] for before, after in pairwise(reports))
    assert max(abs(share - calls / model.calls) for share, calls in reports) < 0.25
    assert reports[-1][0] < 1.0
    assert all(share > 0.0 for share, _ in reports[2:])  # also while the base parameters are fitted


def test_a_round_that_takes_longer_than_expected_never_seems_done():
    shares: list[float] = []
    meter = Meter(lambda share, text: shares.append(share))
    meter.begin_round(30, 0)
    for _ in range(100):
        meter.advance("refit", 10)
    assert shares[0] == pytest.approx(1.0 / 3.0)
    assert shares[-1] == pytest.approx(1.0 / 1.1)
