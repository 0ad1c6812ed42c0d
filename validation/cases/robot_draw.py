"""Draw cases: a robot, its logs, and the truth, in memory.

Seeds below 1000 are for tuning; scores use others.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Final, Literal

import numpy as np

from simgap.arrays import Array
from simgap.logs import JointLog, Logs, Motion, Signal
from simgap.robot import Robot
from validation.cases import robot_setup
from validation.cases.robot_table import ENTRIES, OUTSIDE, Entry, PlacedEntry, entries_of, list_hypotheses
from validation.cases.robot_truth import TRUE_STEP_S, Nuisances, Plant, Scene, TrueEffect
from validation.cases.servo_truth import FACTORS, SPIKE_RAD, SPIKE_SHARE, ServoPlant

Kind = Literal["none", "single", "pair", "triple", "outside"]
COUNTS: Final[dict[Kind, int]] = {"none": 0, "single": 1, "pair": 2, "triple": 3, "outside": 1}
TIMES_LIMIT: Final = (0.5, 4.0)
"""Range of the strength of an effect, in family-wise limits."""
SERVO_TIMES_LIMIT: Final = (1.0, 20.0)
"""That of a servo: its logs are long and its limits small, beside what real servos have."""
SPREADS: Final = {"damping": 0.2, "friction": 0.2, "armature": 0.1, "gain": 0.1}
"""Standard deviations of the logarithms of the nuisances of joints whose numbers are not known."""
START_S: Final = 1.0
"""Time of a motion that does not count in the limits. Friction holds a joint anywhere near its first command,
and a solver knows the start only from the log. After this time nothing is left of it."""
UNKNOWN: Final = 1.0
"""Prior of these nuisances in the limits: a robot file does not say how well it knows a number, so that who
reads it has to allow for an error as large as the number."""
LIMIT_STEP_S: Final = 0.001
"""Step of the simulations that only give changes: differences of runs with the same step."""
SIZE_ROUNDS: Final = 10
"""Simulations in the search for a size; each divides its error by some five."""
CLOSE: Final = 0.03
"""Share by which the strength may miss what was drawn; the strength that is reached is recorded."""
WARM_UP_K: Final = 15.0
"""Rise of the temperature of the motors over all motions."""


@dataclass(frozen=True, slots=True)
class DrawnEffect:
    """True effect of a case."""

    name: str
    place: str
    family: str
    size: float
    shape: float
    times_limit: float
    """Strength in family-wise limits."""
    families: tuple[str, ...]
    """Families that a verdict may give."""


@dataclass(frozen=True, slots=True)
class Truth:
    """Truth of a case."""

    model: str
    kind: Kind
    seed: int
    effects: tuple[DrawnEffect, ...]
    nuisances: dict[str, tuple[float, ...]]
    """Factors on the nominal numbers, an entry a joint."""


class NoSize(ValueError):
    """No size within the bounds of the effect has the wanted strength."""


@dataclass(frozen=True, slots=True, eq=False)
class CaseMotions:
    """Motions of a case, and what their changes are compared with."""

    robot: Robot
    plan: robot_setup.Plan
    fitted: tuple[int, ...]
    nuisances: Nuisances
    base: Array
    """Shown positions of the fitted motions without effects, (n_fitted, n_joints, n) [rad]."""
    nuisance: robot_setup.Nuisance
    limit: float
    """Strength at the family-wise limit."""
    times_limit: tuple[float, float]
    """Range of the strength of an effect, in these limits."""


def draw_case(seed: int, kind: Kind, model: str) -> tuple[Robot, Logs, Truth]:
    """Draw robot, logs with held-out motions, and truth of a case of a key of `ARMS`, the same by seed."""
    truth = draw_truth(seed, kind, model)
    return robot_setup.load_robot(model), record_logs(truth), truth


def draw_truth(seed: int, kind: Kind, model: str) -> Truth:
    """Draw the effects and the nuisances of a case; two effects differ in place or in family."""
    if not COUNTS[kind]:
        return make_truth(seed, kind, model, ())
    campaign = make_campaign(seed, model)
    rng = np.random.default_rng([seed, 2, list(robot_setup.MODELS).index(model)])
    entries = OUTSIDE if kind == "outside" else entries_of(campaign.robot)
    drawn: tuple[DrawnEffect, ...] = ()
    while len(drawn) < COUNTS[kind]:
        drawn = (*drawn, draw_effect(campaign, entries, drawn, rng))
    return make_truth(seed, kind, model, drawn)


def make_truth(seed: int, kind: Kind, model: str, effects: tuple[DrawnEffect, ...]) -> Truth:
    """Return the truth of a case with these effects."""
    nuisances = make_motions(seed, model).nuisances
    factors = {name: tuple(np.asarray(getattr(nuisances, name)).tolist()) for name in SPREADS}
    return Truth(model, kind, seed, effects, factors)


@lru_cache(maxsize=4)
def make_motions(seed: int, model: str) -> CaseMotions:
    """Draw motions and nuisances of a case, and simulate them; nothing in them imitates an effect yet."""
    robot = robot_setup.load_robot(model)
    rng = np.random.default_rng([seed, 1, list(robot_setup.MODELS).index(model)])
    plan = robot_setup.draw_plan(robot, rng)
    fitted = tuple(k for k, name in enumerate(plan.names) if name not in robot_setup.HELD_OUT)
    known = np.array([joint.is_known for joint in robot.joints])
    if robot_setup.MODELS[model].is_servo:
        factors = {name: rng.uniform(*ends, size=1) for name, ends in FACTORS.items()}
    else:
        factors = {
            name: np.where(known, 1.0, np.exp(spread * rng.standard_normal(known.size)))
            for name, spread in SPREADS.items()
        }
    nuisances = Nuisances(**factors)
    base = simulate_fitted(make_plant(robot, nuisances), plan, fitted)
    plan = replace(plan, scene=replace(plan.scene, lowest_m=robot_setup.lowest_m(robot, base)))
    nothing = robot_setup.make_nuisance(np.zeros((whiten_later(base).size, 0)))
    limit = robot_setup.limit_noncentrality(len(fitted), len(list_hypotheses(robot, entries_of(robot))))
    times_limit = SERVO_TIMES_LIMIT if robot_setup.MODELS[model].is_servo else TIMES_LIMIT
    return CaseMotions(robot, plan, fitted, nuisances, base, nothing, limit, times_limit)


@lru_cache(maxsize=4)
def make_campaign(seed: int, model: str) -> CaseMotions:
    """Make the motions of a case, and simulate what its effects are compared with."""
    made = make_motions(seed, model)
    factors = {name: np.asarray(getattr(made.nuisances, name)) for name in SPREADS}
    columns = []
    for name, spread in SPREADS.items():
        for j in np.flatnonzero([not joint.is_known for joint in made.robot.joints]):
            changed = factors[name].copy()
            changed[j] *= np.exp(0.3 * spread)
            moved = Nuisances(**{**factors, name: changed})
            change = simulate_fitted(make_plant(made.robot, moved), made.plan, made.fitted) - made.base
            columns.append(whiten_later(change) * UNKNOWN / (0.3 * spread))
    return replace(made, nuisance=robot_setup.make_nuisance(np.array(columns).T)) if columns else made


def whiten_later(change_rad: Array) -> Array:
    """Whiten changes of positions, (.., n), without the start of the motions, in one row."""
    return np.asarray(robot_setup.whiten(change_rad)[..., round(START_S / robot_setup.PERIOD_S) :].ravel())


def make_plant(
    robot: Robot, nuisances: Nuisances, effects: Sequence[TrueEffect] = (), step_s: float = 0.0
) -> Plant | ServoPlant:
    """Make a true robot: the nominal one with nuisances and effects; without a step, that of limits."""
    if robot_setup.MODELS[robot.name].is_servo:
        return ServoPlant(robot, nuisances, effects, step_s or 2.0 * LIMIT_STEP_S)
    return Plant(robot, nuisances, effects, step_s or LIMIT_STEP_S)


def simulate_motion(plant: Plant | ServoPlant, plan: robot_setup.Plan, k: int, seed: int) -> Array:
    """Return shown positions of a motion without noise, (n_joints, n) [rad]."""
    inputs = plan.commands[k], robot_setup.PERIOD_S, seed, temperature_degC(k)
    if isinstance(plant, Plant):
        return plant.simulate(*inputs)
    assert plan.gains is not None
    return plant.simulate(*inputs, plan.gains[k])


def simulate_fitted(plant: Plant | ServoPlant, plan: robot_setup.Plan, motions: tuple[int, ...]) -> Array:
    """Return shown positions without noise, (n_motions, n_joints, n) [rad]."""
    return np.array([simulate_motion(plant, plan, k, k) for k in motions])


def temperature_degC(motion: int) -> tuple[float, float]:
    """Return the temperature of the motors at the first and the last sample of a motion."""
    first, last = (25.0 + WARM_UP_K * (motion + end) / 12.0 for end in (0, 1))
    return first, last


def change_of(campaign: CaseMotions, effect: TrueEffect, motions: Sequence[int] | None = None) -> Array:
    """Return the whitened change of the fitted motions, or of some, given by their places, (n,)."""
    chosen = range(len(campaign.fitted)) if motions is None else motions
    plant = make_plant(campaign.robot, campaign.nuisances, (effect,))
    moved = simulate_fitted(plant, campaign.plan, tuple(campaign.fitted[k] for k in chosen))
    return whiten_later(moved - campaign.base[list(chosen)])


def strength(campaign: CaseMotions, effect: TrueEffect) -> float:
    """Return the strength of an effect, without what the nuisances imitate; see `limits`.

    A large imitation is no straight line, so the nuisances are simulated where the linear one leads.
    """
    change = change_of(campaign, effect)
    if not campaign.nuisance.columns.size:
        return float(np.linalg.norm(change))
    known = np.array([joint.is_known for joint in campaign.robot.joints])
    amounts = (campaign.nuisance.solve @ change).reshape(len(SPREADS), -1)
    factors = {name: np.asarray(getattr(campaign.nuisances, name)).copy() for name in SPREADS}
    for name, amount in zip(SPREADS, amounts, strict=True):
        factors[name][~known] *= np.exp(UNKNOWN * amount)
    plant = make_plant(campaign.robot, Nuisances(**factors))
    imitated = whiten_later(simulate_fitted(plant, campaign.plan, campaign.fitted) - campaign.base)
    left = [change, change - imitated]
    return float(np.sqrt(max(min(robot_setup.information(one, one, campaign.nuisance) for one in left), 0.0)))


def draw_effect(
    campaign: CaseMotions, entries: tuple[Entry, ...], others: Sequence[DrawnEffect], rng: np.random.Generator
) -> DrawnEffect:
    """Draw an effect that differs from others in place or in family."""
    taken = {(one.place, one.family) for one in others}
    while True:
        try:
            one = _draw_sized(campaign, entries, rng)
        except (NoSize, FloatingPointError):
            continue
        if (one.place, one.family) not in taken:
            return one


def _draw_sized(campaign: CaseMotions, entries: tuple[Entry, ...], rng: np.random.Generator) -> DrawnEffect:
    """Draw an effect, then one of its places, then a strength; NoSize if its bounds do not allow it."""
    everything = list_hypotheses(campaign.robot, entries)
    names = sorted({one.entry.kind.name for one in everything})
    name = names[int(rng.integers(len(names)))]
    places = [one for one in everything if one.entry.kind.name == name]
    one = places[int(rng.integers(len(places)))]
    shape = float(rng.uniform())
    sign = float(rng.choice((-1.0, 1.0))) if one.entry.is_signed else 1.0
    times = float(np.exp(rng.uniform(*np.log(campaign.times_limit))))
    effect, reached = find_size(campaign, one, sign, shape, times)
    kind = one.entry.kind
    accepted = tuple(sorted(map(str, kind.families)))
    return DrawnEffect(kind.name, one.place, str(kind.family), effect.size, shape, reached, accepted)


def make_effect(drawn: DrawnEffect, scene: Scene) -> TrueEffect:
    """Make the effect of a drawn one."""
    kind = next(one.kind for one in (*ENTRIES, *OUTSIDE) if one.kind.name == drawn.name)
    return kind(scene, drawn.place, drawn.size, drawn.shape)


def find_size(
    campaign: CaseMotions, one: PlacedEntry, sign: float, shape: float, times: float
) -> tuple[TrueEffect, float]:
    """Search the size with a strength of `times` family-wise limits; return the effect and what it reaches.

    NoSize if no size within its bounds has a strength in the range, FloatingPointError if the truth diverged.
    """
    size, high = one.entry.typical, one.entry.high
    below, above, best = 0.0, np.inf, (np.inf, 0.0, 0.0)
    for _ in range(SIZE_ROUNDS):
        effect = one.entry.kind(campaign.plan.scene, one.place, sign * size * one.scale, shape)
        reached = strength(campaign, effect) / campaign.limit
        best = min(best, (abs(np.log(max(reached, 1e-9) / times)), size, reached))
        if best[0] < CLOSE:
            break
        below, above = (max(below, size), above) if reached < times else (below, min(above, size))
        if below >= high:
            break
        guess = size * float(np.clip(times / max(reached, 1e-9), 0.1, 10.0))
        size = min(guess if below < guess < above else _between(below, above, size), high)
    _, size, reached = best
    least, most = campaign.times_limit
    if not least <= reached <= most:
        raise NoSize(one.key)
    return one.entry.kind(campaign.plan.scene, one.place, sign * size * one.scale, shape), reached


def _between(below: float, above: float, size: float) -> float:
    if not np.isfinite(above):
        return 2.0 * size
    return float(np.sqrt(below * above)) if below > 0.0 else 0.3 * above


def record_logs(truth: Truth, run: int = 0) -> Logs:
    """Record all motions of a case with noise, quantised.

    Later runs have the same commands, each its own noise, and no motion that is held out.
    """
    campaign, seed = make_motions(truth.seed, truth.model), truth.seed
    effects = [make_effect(one, campaign.plan.scene) for one in truth.effects]
    plant = make_plant(campaign.robot, campaign.nuisances, effects, TRUE_STEP_S)
    plan, times = campaign.plan, robot_setup.sample_times()
    motions = []
    for k in campaign.fitted if run else range(len(plan.names)):
        name = plan.names[k]
        number = run * len(plan.names) + k
        shown = simulate_motion(plant, plan, k, seed * 100 + number)
        rng = np.random.default_rng([seed, 3, number])
        measured = measure(shown, rng)
        gains, gain = plan.gains, 1.0
        if gains is not None:
            gain = float(gains[k].max())
            if rng.uniform() < SPIKE_SHARE:
                measured[:, rng.integers(1, measured.shape[1] - 1)] = SPIKE_RAD
        heat = Signal(times, np.interp(times, times[[0, -1]], temperature_degC(k)))
        joints = {
            joint.name: JointLog(
                position=Signal(times, measured[j]),
                command=Signal(times, plan.commands[k, j]),
                temperature=heat,
                enabled=None if gains is None else Signal(times, (gains[k] > 0.0).astype(float)),
            )
            for j, joint in enumerate(campaign.robot.joints)
        }
        repeat = robot_setup.REPEATED[0] if name in robot_setup.REPEATED else ""
        added = {} if gains is None else {robot_setup.ADDED: 0.0}
        motions.append(Motion(name, joints, dict.fromkeys(joints, gain), repeat, conditions=added))
    return Logs(tuple(motions), robot_setup.HELD_OUT)


def measure(shown_rad: Array, rng: np.random.Generator) -> Array:
    """Add autocorrelated noise and quantise, (n_joints, n) [rad]."""
    white = rng.standard_normal(shown_rad.shape)
    noise = np.empty_like(shown_rad)
    noise[:, 0] = white[:, 0]
    for k in range(1, shown_rad.shape[1]):
        share = robot_setup.CORRELATION
        noise[:, k] = share * noise[:, k - 1] + np.sqrt(1.0 - share**2) * white[:, k]
    quantum = robot_setup.QUANTUM_RAD
    return np.asarray(quantum * np.round((shown_rad + robot_setup.NOISE_RAD * noise) / quantum))
