"""Sensitivities, their normal equations and features, and the next motion that is chosen by them."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from typer.testing import CliRunner

from fsw.config import CYCLE_HZ
from marsarm.cli.app import app
from marsarm.diagnosis import model as linear
from marsarm.diagnosis.arm import finite_differences as steps
from marsarm.diagnosis.arm.case import CaseDiagnosis
from marsarm.diagnosis.arm.next_motion import NextArmMotion, propose_motion, save_files
from marsarm.diagnosis.arm.record import list_motions, make_session, motion_text, read_motion
from marsarm.diagnosis.arm.request import NextRequest
from marsarm.diagnosis.model import build_model
from marsarm.diagnosis.problem import Departures, fit_parabola, load_sensitivities, save_sensitivities
from marsarm.diagnosis.selection import FeatureResiduals, list_competitors, select_simulated
from sim.arms import arm_named, nominal_params
from sim.diagnosis_campaign import run_session, start_session
from sim.initialisation import true_reference
from simgap import verdict_lines
from simgap.common.errors import BadRequest, UserError
from simgap.common.page import Origin
from simgap.common.report import to_json
from simgap.next_motion.rivals import choose_rivals
from simgap.residuals.residuals import split_sizes
from tests.marsarm.diagnosis.worlds import select_and_diagnose, sized, world


def test_a_parabola_goes_through_both_steps_and_one_step_makes_a_line(rng):
    slope, curve = rng.normal(size=(2, 5))
    ends = [(slope * x + curve * x**2, x) for x in (0.5, -0.8)]
    np.testing.assert_allclose(fit_parabola(ends), (slope, curve))
    np.testing.assert_allclose(fit_parabola(ends[:1]), (slope + 0.5 * curve, np.zeros(5)))


def test_what_is_kept_comes_back_and_a_damaged_or_another_file_is_refused(made, tmp_path):
    path = tmp_path / "s.npz"
    save_sensitivities(path, made)
    assert to_json(load_sensitivities(path, made.hypotheses, made.nuisances)) == to_json(made)
    assert [path.name for path in tmp_path.iterdir()] == ["s.npz"]
    whole = path.read_bytes()
    np.savez(path, a=np.zeros(3))
    for content in (path.read_bytes(), *(whole[: int(share * len(whole))] for share in (0.0, 0.5, 0.99))):
        path.write_bytes(content)
        with pytest.raises(BadRequest, match=r"s\.npz: no sensitivities .*remove it"):
            load_sensitivities(path, (), ())


def test_a_robot_that_cannot_be_simulated_has_no_sensitivities(made):
    with pytest.raises(ValueError, match="must be finite"):
        replace(made, effect=np.nan * made.effect)


@pytest.mark.parametrize(
    "per_typical",
    np.geomspace(
        2 * steps.TARGET_SIGMAS / steps.MAX_STEP_SHARE, steps.TARGET_SIGMAS / steps.MIN_STEP_SHARE / 2, 7
    ),
)
def test_a_step_along_a_line_is_adapted_at_once(per_typical):
    better = steps.adapt_step(1.0, per_typical) or 1.0
    assert 1.0 / steps.MAX_STEP_RATIO <= better * per_typical / steps.TARGET_SIGMAS <= steps.MAX_STEP_RATIO
    assert steps.adapt_step(better, better * per_typical) is None
    assert steps.step_error(better * per_typical) < steps.step_error(0.0)


def test_a_step_beyond_a_jump_comes_back_before_it():
    """A backlash changes sides at 0.05 of a typical size, and hides what is visible from 0.02 on."""
    share = 1.0
    for _ in range(steps.MAX_ROUNDS):
        share = steps.adapt_step(share, 100.0 * share + (400.0 if share > 0.05 else 0.0)) or share
    assert share < 0.05


@pytest.fixture(scope="module")
def small():
    """Return a campaign small enough for dense matrices."""
    return world(seed=3, m=160, effects=4, places=2, nuisances=4, blocks=5, alike=1, two=1)


def _dense(made):
    """Return the covariance of the features in their units."""
    layout = made.layout
    V = np.diag(layout.sigma**2)
    for index, nuisance in enumerate(made.nuisances):
        n = made.nuisance[:, index] * nuisance.sigma
        same = layout.block[:, None] == layout.block[None, :] if nuisance.random_per_block else 1.0
        V = V + np.outer(n, n) * same
    return V


def likelihood_ratio(equations, y, chosen):
    """Return the deviance that hypotheses explain: a'R a, with nuisances eliminated."""
    columns = np.isin(equations.owner, chosen)
    a = linear.fit_linear(equations, y, chosen).theta[equations.q :]
    return float(a @ equations.R[np.ix_(columns, columns)] @ a)


def test_a_fit_is_generalised_least_squares(small, rng):
    equations, V = linear.form_normal_equations(small), _dense(small)
    y, S = small.measured(rng), small.effect[:, np.isin(small.owner, (1, 3))]
    t = np.linalg.solve(S.T @ np.linalg.solve(V, S), S.T @ np.linalg.solve(V, y))
    before, after = (rest @ np.linalg.solve(V, rest) for rest in (y, y - S @ t))
    found = likelihood_ratio(equations, equations.whiten(y), (1, 3))
    assert found == pytest.approx(before - after, rel=1e-6)


def test_the_full_whitener_leaves_white_noise(small):
    """W V W' is the identity, with V the covariance by noise and all nuisances."""
    W = linear.build_full_whitener(small)(np.eye(small.layout.size))
    np.testing.assert_allclose(W @ _dense(small) @ W.T, np.eye(small.layout.size), atol=1e-6)


def test_what_is_alike_shares_a_class_and_nothing_else_does(campaign):
    cosine, label = linear.alias_cosines(campaign.equations), linear.equivalence_classes(campaign.equations)
    same = label[:, None] == label[None, :]
    assert label.max() + 1 == 30
    assert np.all(cosine[~same] <= 0.99)
    assert np.all(cosine[same] > 0.99)


def test_what_nuisances_imitate_is_not_seen(small):
    free = tuple(replace(n, sigma=1e6, random_per_block=False) for n in small.nuisances)
    effect = np.column_stack([small.nuisance[:, 3], small.effect[:, 1:]])
    equations = linear.form_normal_equations(replace(small, nuisances=free, effect=effect))
    assert list(np.flatnonzero(~equations.identifiable)) == [0]
    assert linear.detection_limits(equations, linear.equivalence_classes(equations))[0][0] == np.inf


def test_the_detection_limit_is_found_in_nine_of_ten(made, campaign, rng):
    """Power of the likelihood-ratio test at the limit, simulated: the interval of 400 cases is +-3 %."""
    one = int(np.flatnonzero(np.bincount(made.owner) == 2)[0])
    limit = campaign.limits[one]
    hits = 0
    for _ in range(400):
        y = made.measured(rng, t=np.where(made.owner == one, limit, 0.0))
        found = likelihood_ratio(campaign.equations, campaign.equations.whiten(y), (one,))
        hits += found > chi2.isf(0.05, 2)
    assert 0.86 <= hits / 400 <= 0.94
    assert linear.noncentrality(1) == pytest.approx((1.959964 + 1.281552) ** 2, rel=1e-3)


WORLD = SENSITIVITIES = world(bent=0.3)
MODEL = linear.build_model(SENSITIVITIES)
EFFECTS = list_competitors(MODEL)
WHITEN = linear.build_full_whitener(SENSITIVITIES)


def test_the_change_by_effects_is_that_of_the_sensitivities():
    """Also beyond their reach, and for several effects at once."""
    rng = np.random.default_rng(3)
    value, some = WORLD.measured(rng), EFFECTS[4:12:3]
    sizes = rng.uniform(-2.0, 2.0, sum(len(one.sizes) for one in some))
    change = SENSITIVITIES.change(dict(split_sizes(some, sizes)))
    found = FeatureResiduals(SENSITIVITIES, WHITEN, value).residuals(some, sizes[None])
    np.testing.assert_allclose(found[0], WHITEN(value - change), atol=1e-8)


def test_a_parabola_goes_through_what_was_simulated_and_its_secant_too():
    rng = np.random.default_rng(4)
    for h in (3, int(np.flatnonzero(np.bincount(WORLD.owner) == 2)[0])):
        hypothesis = SENSITIVITIES.hypotheses[h]
        a = rng.uniform(1.0, 3.0, len(hypothesis.parameters))
        change = rng.normal(size=WORLD.layout.size)
        simulated = SENSITIVITIES.with_simulated(h, a, change)
        for one in (simulated, simulated.linearised(h, a)):
            np.testing.assert_allclose(one.change({hypothesis: a}), change)


def test_a_class_competes_once_by_the_member_with_the_widest_bounds():
    """The bounds of the first members are one typical size; those of their copies are a thousand."""
    labels = [MODEL.label[SENSITIVITIES.index(one.key)] for one in EFFECTS]
    assert len(set(labels)) == len(labels) == int(MODEL.label.max()) + 1
    pairs = [of for k in range(len(SENSITIVITIES.hypotheses)) if len(of := MODEL.equivalence_class(k)) == 2]
    assert pairs
    hypotheses = list(SENSITIVITIES.hypotheses)
    for first, _ in pairs:
        narrow = [replace(one, least=-one.typical, most=one.typical) for one in hypotheses[first].parameters]
        hypotheses[first] = replace(hypotheses[first], parameters=tuple(narrow))
    model = replace(MODEL, sensitivities=replace(SENSITIVITIES, hypotheses=tuple(hypotheses)))
    chosen = {SENSITIVITIES.index(one.key) for one in list_competitors(model)}
    assert {second for _, second in pairs} <= chosen
    assert not {first for first, _ in pairs} & chosen


def test_a_nuisance_of_the_same_parameter_bends_with_the_effect():
    """At the simulated size it has the slope of the parabola; other nuisances stay."""
    h, a = 3, np.array([2.0])
    (column,) = np.flatnonzero(WORLD.owner == h)
    nuisance = SENSITIVITIES.nuisance.copy()
    nuisance[:, 5] = 0.1 * SENSITIVITIES.effect[:, column]
    given = replace(SENSITIVITIES, nuisance=nuisance)
    slope = given.effect[:, column]
    bent = given.with_simulated(h, a, 3.0 * slope)  # 2 a by the slope, and a^2 / 4
    np.testing.assert_allclose(bent.nuisance[:, 5], 0.1 * 2.0 * slope)
    np.testing.assert_array_equal(np.delete(bent.nuisance, 5, 1), np.delete(nuisance, 5, 1))


def test_a_second_simulation_does_not_depend_on_the_first():
    """A selection that simulates twice begins at the sensitivities of the campaign each time."""
    h, sizes = 3, list[np.ndarray]()
    (column,) = np.flatnonzero(SENSITIVITIES.owner == h)

    def respond(a: np.ndarray) -> np.ndarray:
        """Grow faster than any parabola."""
        return SENSITIVITIES.effect[:, column] * float(a[0] + 0.02 * a[0] ** 3)

    def simulate(settings: Departures) -> np.ndarray:
        sizes.extend(settings.values())
        return respond(sizes[-1])

    found = select_simulated(MODEL, WHITEN, respond(np.array([6.0])), 1, simulate)
    assert found.chosen == (h,)
    assert len(sizes) > 1
    last = SENSITIVITIES.with_simulated(h, sizes[-1], respond(sizes[-1]))
    np.testing.assert_array_equal(found.sensitivities.nuisance, last.nuisance)
    np.testing.assert_array_equal(found.sensitivities.curve, last.curve)
    np.testing.assert_allclose(*found.departures.values(), 6.0, rtol=0.02)


@pytest.mark.parametrize("shown", [0.0, np.nan])
def test_an_effect_that_its_simulation_refutes_is_none_where_no_other_is_left(shown):
    made = world(effects=1, places=1, alike=0, two=0)
    made = replace(made, reach=np.full_like(made.reach, 0.01))
    model, rng = build_model(made), np.random.default_rng(1)
    value = made.measured(rng, sized(made, model, 0, 6.0), robot=1)
    simulators = None, lambda _: np.full(value.size, shown)
    found = [select_and_diagnose(model, value, one) for one in simulators]
    assert [len(one.findings) for one in found] == [1, 0]
    assert found[1].remaining


MOTIONS = {f"motion {k}": one for k, one in zip(range(15), list_motions(nominal_params()), strict=False)}


def test_the_motion_in_which_rivals_differ_most_is_chosen(made, campaign, results):
    """All blocks but one are made blind; the one that is left has to be chosen."""
    blind = np.where(made.layout.block == "motion 6", 1.0, 1e6)
    layout = replace(made.layout, sigma=0.1 * blind * made.layout.sigma)
    rivals = choose_rivals(results["undecided"].rivals)
    proposal, best = propose_motion(campaign, rivals, replace(made, layout=layout), MOTIONS)
    assert proposal.rivals[0] == proposal.finding
    assert len(proposal.rivals) > 1
    assert best == MOTIONS["motion 6"]
    assert proposal.motions[proposal.choice.motions[0]] == best.describe()
    assert proposal.curves
    assert all(np.all(np.diff(one.time_s) > 0.0) for one in proposal.curves)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("count = 2", "count = 0"),
        ('joint = "elbow"', 'joint = "knee"'),
        ("speed_share = 1", "speed_share = 3"),
        ("hold_s = 1", "hold_s = 0"),
        ("turn_deg = -1", "turn_deg = 0"),
        ("start_deg = [0", "start_deg = [300"),
        ('name = "next-8"', 'name = "elsewhere-cold"'),
    ],
)
def test_a_motion_is_read_again_from_its_file_and_a_wrong_one_is_refused_with_its_key(tmp_path, old, new):
    params, path = nominal_params(), tmp_path / "next.toml"
    motions = [*list_motions(params, {"elbow"}, {"sweep-elbow", "next-7", "next-3"})]
    assert {one.joint for one in motions} == {"elbow", "all"}
    assert [one.name for one in motions[:2]] == ["next-8", "next-9"]  # after those that are known
    path.write_text(motion_text(motions[0]))
    assert read_motion(path, params) == motions[0]
    path.write_text(re.sub("hold_s = .*", "", motion_text(motions[0])))  # as before motions had rests
    assert read_motion(path, params) == motions[0]
    path.write_text(motion_text(motions[0]))
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(UserError, match=rf"next\.toml: {old.split()[0]}"):
        read_motion(path, params)
    path.write_text('name = "servo arm"')
    with pytest.raises(
        BadRequest, match=r"next\.toml: is no motion; give a file that `gap next --out` wrote"
    ):
        read_motion(path, params)


@pytest.mark.parametrize("arm", ["nominal", "m2020"])
def test_every_motion_begins_and_ends_within_the_limits_of_every_arm(arm, tmp_path):
    """Reading refuses another; its file says where it begins."""
    params, path = arm_named(arm).params, tmp_path / "next.toml"
    for motion in list_motions(params):
        path.write_text(motion_text(motion))
        start = make_session(read_motion(path, params), params).start_rad
        np.testing.assert_allclose(np.degrees(start), motion.start_deg, atol=1e-6)


@pytest.mark.parametrize("hold_s", [1.0, 30.0])
def test_the_arm_completes_a_proposed_motion_and_rests_before_it_is_measured(hold_s):
    arm = arm_named("nominal")
    motion = next(one for one in list_motions(arm.params, {"wrist"}) if one.hold_s == hold_s)
    session = make_session(motion, arm.params)
    cycles = [*run_session(start_session(session, arm, true_reference(arm), seed=1), session)]
    rested = [k for k, one in enumerate(cycles) if one.rested]
    assert len(rested) == 1 + len(session.commands)
    assert min(np.diff([-1, *rested])) >= hold_s * CYCLE_HZ


def test_without_a_motion_that_tells_anything_apart_no_file_is_written(tmp_path, made, campaign, results):
    deaf = replace(made.layout, sigma=1e6 * made.layout.sigma)
    rivals = choose_rivals(results["undecided"].rivals)
    proposal = propose_motion(campaign, rivals, replace(made, layout=deaf), MOTIONS)
    request = NextRequest((tmp_path,), out=tmp_path / "next.toml")
    assert save_files(NextArmMotion(request, *proposal, Origin("", {}))) == []
    assert not (tmp_path / "next.toml").exists()


def test_the_command_writes_a_motion_that_gap_record_reads_and_a_page_or_says_what_was_found(
    tmp_path, monkeypatch, made, campaign, results
):
    """It has a given diagnosis and given sensitivities of the planned motions."""
    monkeypatch.chdir(tmp_path)
    results = dict(results)
    recorded: list[str] = []

    def diagnose(request, progress):
        return CaseDiagnosis(results["undecided"], (), campaign, nominal_params())

    def record(folder, sessions, *_):
        recorded.extend(one.name for one in sessions)
        return [folder / f"{one.name}.mcap" for one in sessions]

    def compute(logs, kept_in, run, progress, kinds, steps_of, arm):
        assert set(kinds) <= {one.name for one in made.hypotheses}
        block = np.array([recorded[int(one.split()[1])] for one in made.layout.block])
        layout = replace(made.layout, block=block, sigma=0.01 * made.layout.sigma)
        return replace(made, layout=layout)

    for name, stand_in in (("diagnose", diagnose), ("compute_sensitivities", compute)):
        monkeypatch.setattr(f"marsarm.diagnosis.arm.next_motion.{name}", stand_in)
    monkeypatch.setattr("marsarm.diagnosis.arm.record.record_campaign", record)
    words = ("--out", "next.toml", "--report", "next.html", "--json")
    done = CliRunner().invoke(app, ["gap", "next", "a.mcap", *words])
    said = json.loads(done.stdout)
    assert done.exit_code == 0
    assert read_motion(tmp_path / "next.toml", nominal_params()).describe() == said["motions"][0]["motion"]
    assert "<polygon" in (tmp_path / "next.html").read_text()
    results["undecided"] = results["nothing"]
    done = CliRunner().invoke(app, ["gap", "next", "a.mcap"])
    assert done.exit_code == 2
    assert done.stderr.startswith("no finding has a rival")
    assert all(line in done.stderr for line in verdict_lines(results["nothing"]))
