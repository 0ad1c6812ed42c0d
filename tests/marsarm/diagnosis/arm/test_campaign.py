"""The residual of a nominal arm is noise, at rest and in motion; the audit notes errors of a recording."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fsw.config import CYCLE_HZ
from fsw.dictionary.enums import Frame, Joint
from helpers.marks import slow_but
from marsarm.common.pool import local_runner
from marsarm.diagnosis.arm import feature_set, features
from marsarm.diagnosis.arm import finite_differences as steps
from marsarm.diagnosis.arm.arm_effects import list_hypotheses, list_nuisances
from marsarm.diagnosis.arm.audit import audit_recordings, find_anomalies, find_missing_motion, refusals
from marsarm.diagnosis.arm.campaign_sensitivities import compute_sensitivities
from marsarm.diagnosis.arm.case_simulator import (
    build_case_simulator,
    resimulate,
)
from marsarm.diagnosis.arm.logs import Recording, find_touch, load_recording, world_from_imu
from marsarm.diagnosis.arm.record import record_campaign
from marsarm.diagnosis.arm.rest_poses import simulate_open_loop, stack_readings
from marsarm.diagnosis.problem import Hypothesis
from sim.arm_model.load import default_arm
from sim.arms import arm_named, nominal_params
from sim.diagnosis_campaign import campaign_sessions
from sim.effects.environment import ContactStiffness, Slip, SurfacePosition
from sim.effects.geometry import LinkLength
from sim.effects.joints import GearStiffness, ResolverBias
from sim.effects.sensors import CurrentGain, EncoderZero, ResolverEccentricity
from sim.initialisation import true_reference
from sim.setting import World
from validation.cases.arm_truth import list_uncatalogued

NUISANCES = [*list_nuisances(default_arm())]


@pytest.fixture(scope="module")
def campaign(recordings: list[Recording]) -> feature_set.FeatureSet:
    """Return the features of all recordings."""
    return feature_set.build_feature_set(recordings)


@pytest.fixture(scope="module")
def touch(campaign: feature_set.FeatureSet) -> features.MotionFeatures:
    """Return the only motion: a placement up to its touch."""
    (motion,) = campaign.motions
    return motion


def columns_of(name: str) -> tuple[list[steps.Column], list[int]]:
    """List the columns of an effect of the catalogue and those of the nuisances, and indices of the first."""
    hypotheses = [*list_hypotheses([name])]
    return steps.list_columns(hypotheses, NUISANCES), [*range(sum(len(one.parameters) for one in hypotheses))]


def test_a_nominal_arm_leaves_its_sensors_noise(campaign):
    rest = feature_set.measure_features(campaign) - feature_set.simulate_features(campaign, ())
    whitened = rest / feature_set.lay_out(campaign)[0].sigma
    channels = np.array([feature.channel for feature in campaign.list_features()])
    for channel in sorted(set(channels)):
        mine = whitened[channels == channel]
        assert np.sqrt(np.mean(mine**2)) < 1.5, features.CHANNELS[channel]


def test_repeats_of_a_motion_are_one_block_and_say_what_the_floor_is(campaign):
    assert {f.recording.block for f in campaign.list_features()} == {"poses-level-1", "place-apxs"}
    _, notes = feature_set.lay_out(campaign)
    assert any("pairs of repeats" in note for note in notes)
    assert any(note.startswith("current") and "assumed" in note for note in notes)


def test_a_feature_that_only_a_repeat_has_is_not_compared(recordings):
    once = next(one for one in recordings if one.world.surface)
    campaign = feature_set.build_feature_set([once, replace(once, name="again")])
    first, again = campaign.motions
    odd = replace(again, features=(replace(again.features[0], key="odd"), *again.features[1:]))
    campaign = replace(campaign, motions=(first, odd))
    layout, _ = feature_set.lay_out(campaign)
    assert build_case_simulator(campaign, layout, 0).rows.size == layout.size - 1


@pytest.mark.slow
def test_motions_that_are_not_resimulated_are_extrapolated(campaign):
    """Rests and touches are always computed; motions if they are wanted."""
    layout, _ = feature_set.lay_out(campaign)
    patch, by = (GearStiffness(Joint.ELBOW, 0.8),), np.full(layout.size, 1e-3)
    before, after = (build_case_simulator(campaign, layout, 0, some) for some in ((), patch))
    everything, nothing = (resimulate(before, patch, only, by) for only in (lambda _: True, lambda _: False))
    rests = np.array([
        feature.regime in ("rest", "pose", "touch", "press") and feature.channel != features.IMU
        for feature in campaign.list_features()
    ])  # fmt: skip
    np.testing.assert_array_equal(everything.nominal, after.nominal)
    np.testing.assert_array_equal(nothing.nominal[rests], after.nominal[rests])
    np.testing.assert_allclose((nothing.nominal - before.nominal)[~rests], 1e-3, rtol=1e-9)
    assert not np.allclose(after.nominal[rests], before.nominal[rests], atol=1e-6)


def test_a_longer_link_moves_the_turret_by_as_much(campaign):
    poses = feature_set.FeatureSet((), campaign.rests)
    longer = (LinkLength(Frame.ARM3, "x", 1e-3),)
    after, before = (feature_set.simulate_features(poses, some) for some in (longer, ()))
    moved = after - before
    channels = np.array([feature.channel for feature in poses.list_features()])
    shift = moved[channels == features.TRANSLATION].reshape(len(poses.rests), 3, -1)
    np.testing.assert_allclose(np.linalg.norm(shift, axis=1), 1e-3, rtol=0.02)
    assert np.abs(moved[channels == features.ROTATION]).max() < 1e-5


def test_no_tick_after_the_last_bin_influences_a_feature(touch):
    whole = stack_readings(simulate_open_loop(touch.recording, ())[0])
    part = feature_set.simulate_motion(touch, ())
    assert len(part["cycle"]) == touch.compared_ticks < touch.recording.ticks / 2
    of_part, of_whole = (features.evaluate_features(touch, some) for some in (part, whole))
    np.testing.assert_allclose(of_part, of_whole, rtol=1e-12, atol=0.0)


def test_what_only_reads_is_read_as_avionics_do_without_another_step(touch):
    remanent = list_uncatalogued()["remanent-core", "elbow"]  # a sensor with memory
    readers = (
        ResolverBias(Joint.ELBOW, 1e-3),
        ResolverEccentricity(Joint.WRIST, 1e-3, -2e-3),
        CurrentGain(Joint.ELBOW, 1.1),
        remanent.switch_on(np.array([0.1 / remanent.parameters[0].typical])),
    )
    assert all(feature_set.changes_readings_only(effect) for effect in readers)
    assert not feature_set.changes_readings_only(EncoderZero(Joint.ELBOW, 1e-3))
    assert not feature_set.changes_readings_only(GearStiffness(Joint.ELBOW, 1.1))
    ticks = touch.compared_ticks
    anew = stack_readings(simulate_open_loop(touch.recording, readers, ticks=ticks)[0])
    again, plain = (feature_set.simulate_motion(touch, some) for some in (readers, ()))
    for name, values in anew.items():
        np.testing.assert_allclose(again[name], values, rtol=1e-12, atol=1e-12)
        assert np.array_equal(values, plain[name]) == (name not in ("resolver_rad", "current_A"))


def test_nothing_is_compared_near_a_touch(touch):
    """Under the recorded drive another arm would push where the real one did not."""
    closed = np.flatnonzero(touch.recording.sensors["switch_closed"].any(axis=1))[0]
    bins = sum(end <= closed for segment in touch.segments for _, end in segment.bins())
    currents = [feature for feature in touch.features if feature.channel == features.CURRENT]
    assert 0 < len(currents) < bins
    assert min(one.time_s for one in currents) > 0.0
    assert max(one.time_s for one in currents) < closed / CYCLE_HZ


def test_an_arm_with_another_surface_or_link_touches_at_another_height(campaign):
    nominal = feature_set.simulate_touches(campaign, ())[:1]
    assert nominal == pytest.approx([0.0], abs=1e-4)
    nearer = feature_set.simulate_touches(campaign, (SurfacePosition(3e-3),))[:1]
    assert nearer - nominal == pytest.approx([-3e-3], abs=1e-9)
    longer = feature_set.simulate_touches(campaign, (LinkLength(Frame.ARM3, "x", 1e-3),))
    assert campaign.touches[0].tool == "apxs"
    assert 1e-4 < abs(longer[0] - nominal[0]) < 1.1e-3


def test_softer_pads_let_a_pressed_tool_farther_in_and_a_joint_does_not(campaign):
    (press,) = campaign.presses
    at = len(campaign.touches)
    nominal, soft, joint = (
        feature_set.simulate_touches(campaign, some)[at]
        for some in ((), (ContactStiffness(0.5),), (GearStiffness(Joint.ELBOW, 0.5),))
    )
    assert soft == pytest.approx(2.0 * nominal)
    assert joint == nominal
    assert abs(press.measured_m - nominal) < 3.0 * press.feature.sigma
    assert press.feature.sigma < 0.15 * nominal


@pytest.mark.parametrize("missing", [0.0, 0.5])
def test_a_tool_that_leans_touches_as_drawn_and_goes_aside_by_what_friction_does_not_hold(
    tmp_path: Path, missing: float
) -> None:
    (session,) = (one for one in campaign_sessions(nominal_params()) if one.name == "slide-apxs")
    slip = Slip(missing)
    arm = arm_named("nominal").with_effects([slip])
    paths = record_campaign(tmp_path, [session], arm, true_reference(arm), 4, lambda *_: None)
    found = feature_set.build_feature_set([load_recording(path) for path in paths])
    assert feature_set.simulate_touches(found, ())[0] == pytest.approx(0.0, abs=1e-4)
    _, slide = found.presses
    assert slide.predict([]) == slide.predict([GearStiffness(Joint.ELBOW, 0.5)]) == 0.0
    assert slide.feature.sigma < 0.2e-3
    assert slide.measured_m == pytest.approx(slide.predict([slip]), abs=slide.feature.sigma)


def test_a_switch_that_is_always_closed_or_closes_far_away_shows_no_touch(campaign, monkeypatch):
    (one,) = campaign.touches
    recording, touch = one.turning_points.recording, find_touch(one.turning_points.recording)
    switches = recording.sensors["switch_closed"]
    stuck, early = switches.copy(), switches.copy()
    stuck[:, recording.params.tool_switches["drill"][0]] = True
    early[10:, switches[touch]] = True
    stuck_log, early_log = (
        replace(recording, sensors={**recording.sensors, "switch_closed": one}) for one in (stuck, early)
    )
    (found,) = feature_set.build_feature_set([stuck_log]).touches
    assert found.tool == one.tool
    monkeypatch.setattr(feature_set, "FARTHEST_SURFACE_M", 0.01)  # the log begins 0.019 m above the surface
    assert not feature_set.build_feature_set([early_log]).touches


@pytest.mark.parametrize("kind", slow_but(["viscous-friction", "output-friction"]))
def test_joints_simulated_at_once_show_what_each_shows_alone(campaign, kind):
    campaign, (columns, wanted) = replace(campaign, rests=()), columns_of(kind)
    nominal, sigma = feature_set.simulate_features(campaign, ()), feature_set.lay_out(campaign)[0].sigma
    ((*at_once,),) = steps.group_columns(columns, wanted)
    assert at_once == wanted
    assert len(wanted) == len(Joint)
    # a whole typical size: what single counts of the encoders flip by does not grow with the step
    sides = steps.simulate_side(campaign, columns, nominal, 0, dict.fromkeys(wanted, 1.0))
    for hypothesis, side in zip(list_hypotheses([kind]), sides.values(), strict=True):
        effect = hypothesis.switch_on(np.array([side.size]))
        alone = feature_set.simulate_features(campaign, [effect]) - nominal
        off, whole = (x / sigma for x in (side.change - alone, alone))
        # friction at another joint shifts the moment at which a joint begins to turn, and so one bin
        *most, begin = np.sort(np.abs(off))
        assert 0.0 < np.linalg.norm(most) < 0.05 * np.linalg.norm(whole)
        assert begin < 0.05 * np.linalg.norm(whole)


def test_effects_at_one_joint_are_not_simulated_at_once():
    """Asymmetric friction has two directions at each joint; together they would be plain friction."""
    columns, wanted = columns_of("asymmetric-friction")
    for group in steps.group_columns(columns, wanted):
        places = [one.location for k in group if isinstance(one := columns[k].source, Hypothesis)]
        assert len(set(places)) == len(places) == len(Joint)


def test_a_factor_that_is_uncertain_is_simulated_by_its_own_sigma():
    """The large step of the equal hypothesis is not used; all joints are simulated at once."""
    (columns, hypotheses), names = columns_of("gear-friction"), [one.name for one in NUISANCES]
    begin = len(columns) - len(names)
    own = [begin + names.index(f"friction {joint.name.lower()}") for joint in Joint]
    session = [begin + names.index(f"friction {joint.name.lower()} of a session") for joint in Joint]
    borrowed = steps.find_borrowed_slopes(columns)
    assert not set(own) & set(borrowed)
    assert [borrowed[k] for k in session] == [(k, 1.0) for k in own]
    assert [borrowed[k][0] for k in hypotheses] == own
    assert steps.group_columns(columns, own) == [tuple(own)]
    sizes = [columns[k].sides(1.0)[0][1] for k in own]
    assert sizes == [NUISANCES[k - begin].sigma for k in own]


@pytest.mark.slow
def test_sensitivities_are_kept_and_found_again(logs, tmp_path):
    poses = [path for path in logs if path.stem.startswith("poses")]
    calls: list[str] = []
    work, kinds = local_runner(1), ["resolver-bias", "link-stiffness"]

    def noted(*_: object) -> None:
        calls.append("computed")

    first = compute_sensitivities(poses, tmp_path, work, noted, kinds)
    assert calls
    calls.clear()
    again = compute_sensitivities(poses, tmp_path, work, noted, kinds)
    assert not calls
    np.testing.assert_array_equal(first.effect, again.effect)
    biases = [one.name == "resolver-bias" for one in first.hypotheses]
    assert np.linalg.matrix_rank(first.effect[:, biases]) == len(Joint) == sum(biases)
    assert first.layout.channel[0] == "azimuth resolver-encoder"
    named = {one.name: k for k, one in enumerate(first.nuisances)}
    for column, one in zip(first.effect.T, first.hypotheses, strict=True):
        if one.name == "link-stiffness":
            nuisance = first.nuisance[:, named[f"link stiffness {one.place}"]]
            np.testing.assert_array_equal(column, nuisance * one.parameters[0].typical)
            assert np.any(column)


BASE = nominal_params()


def refuse(one: Recording) -> tuple[str, ...]:
    return refusals([one], BASE)


def freeze(values: np.ndarray, end: int, value: float) -> np.ndarray:
    values = values.copy()
    values[100:end, 2] = value
    return values


@pytest.mark.parametrize(
    ("find", "name", "change", "words"),
    [
        (find_anomalies, "resolver_rad", lambda x: freeze(x, 250, x[100, 2]), "is stale"),
        (find_anomalies, "resolver_rad", np.degrees, "another unit"),
        (find_anomalies, "current_A", lambda x: np.clip(x, -0.01, 0.01), "saturated"),
        (find_anomalies, "gravity_R_m_s2", np.degrees, "m/s^2 are wanted"),
        (refuse, "current_A", lambda x: freeze(x, 101, np.nan), "is not a number 1 times, first at 1.56 s"),
        (refuse, "cycle", lambda x: x + 5 * (np.arange(x.size) >= 100), "5 cycles are missing"),
    ],
)
def test_what_is_wrong_with_a_recording_is_noted_or_refused(recordings, find, name, change, words):
    """A good one is passed over in silence."""
    assert [note for one in recordings for note in find(one)] == []
    sensors = {**recordings[0].sensors, name: change(recordings[0].sensors[name])}
    assert any(words in note for note in find(replace(recordings[0], sensors=sensors)))


def test_a_campaign_that_is_too_small_is_noted(recordings):
    alone, repeated = ("\n".join(audit_recordings(some)) for some in (recordings[:1], recordings))
    assert "has 1 motion;" in alone
    assert "no motion was repeated" in alone
    assert "no motion was repeated" not in repeated


def test_logs_in_which_nothing_moves_are_too_little(recordings):
    drive = recordings[2].drive
    still = replace(recordings[2], drive={**drive, "power_on": np.zeros_like(drive["power_on"])})
    assert any("wrist has 0 motions" in sentence for sentence in find_missing_motion([still]))
    assert find_missing_motion([still, recordings[0]]) == ()
    assert find_missing_motion(recordings[2:]) == ()


def test_recordings_of_other_parameters_or_another_drawing_are_refused_once(recordings):
    (sentence,) = refusals(recordings, arm_named("calibrated:1").params)
    assert sentence.startswith("3 of 3 logs were made with other flight parameters")
    foreign = [replace(one, params=arm_named("m2020").params) for one in recordings]
    (sentence,) = refusals(foreign, BASE)
    assert sentence.startswith("logs of the arm m2020, and the diagnosis is of the arm msl")


@pytest.mark.parametrize("scene", ["mars", "earth"])
def test_the_imu_tells_scene_and_tilt_of_a_log_that_does_not(scene):
    tilted = World(scene, 0.3, -0.2)
    seen = world_from_imu(tilted.gravity_N_m_s2, Path("a.mcap"))
    np.testing.assert_allclose(seen.gravity_N_m_s2, tilted.gravity_N_m_s2, atol=1e-12)
    assert (seen.tilt_roll_rad, seen.tilt_pitch_rad) == pytest.approx((0.3, -0.2))
