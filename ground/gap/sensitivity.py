"""How the features change with every hypothesis and nuisance: found once per campaign, and kept."""

import json
import zlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Final
from zipfile import BadZipFile

import numpy as np

from fsw.kinematics.transforms import Array
from ground.gap.hypothesis import Hypothesis, Nuisance, Parameter
from ground.gap.layout import Ints, Layout
from ground.gap.simulator import Simulator
from ground.outputs import written_whole

NUISANCE_STEP: Final = 1.0
"""In prior sigmas; in its own unit for a nuisance of which nothing is known."""


@dataclass(frozen=True, slots=True, eq=False)
class Sensitivities:
    """The simulator about its nominal state, in straight lines and parabolas."""

    layout: Layout
    hypotheses: tuple[Hypothesis, ...]
    nuisances: tuple[Nuisance, ...]
    nominal: Array
    """What is predicted with no effect, (m,)."""
    effect: Array
    """Change per typical size of each size parameter, in the order of `owner`, (m, K)."""
    curve: Array
    """Change per square of that: a parabola through nominal and what could be simulated beside it, (m, K)."""
    reach: Array
    """How far from nominal that was, in typical sizes, (K,)."""
    owner: Ints
    """Which hypothesis each column belongs to, ascending, (K,)."""
    nuisance: Array
    """Change per unit of each nuisance, (m, q)."""

    def __post_init__(self) -> None:
        m, wanted = self.layout.size, [len(hypothesis.sizes) for hypothesis in self.hypotheses]
        if not np.array_equal(self.owner, np.repeat(np.arange(len(wanted)), wanted)):
            raise ValueError("owner must list every size parameter of every hypothesis in order")
        shapes = (
            (self.nominal, (m,)),
            (self.effect, (m, sum(wanted))),
            (self.curve, (m, sum(wanted))),
            (self.reach, (sum(wanted),)),
            (self.nuisance, (m, len(self.nuisances))),
        )
        for array, shape in shapes:
            if array.shape != shape or not np.all(np.isfinite(array)):
                raise ValueError(f"sensitivities must be finite and {shape}; one is {array.shape}")

    @property
    def lasting(self) -> list[int]:
        """The nuisances that are one number for all blocks, by index."""
        return [index for index, nuisance in enumerate(self.nuisances) if not nuisance.each_block]

    def of(self, rows: Ints) -> "Sensitivities":
        """Those of some of the features, in that order."""
        arrays = ("nominal", "effect", "curve", "nuisance")
        return replace(
            self, layout=self.layout.of(rows), **{name: getattr(self, name)[rows] for name in arrays}
        )


def sensitivities(simulator: Simulator, step: Callable[[int, int], None] = lambda *_: None) -> Sensitivities:
    """Differences in the simulator about nominal; `step(done, of)` is told how far it is.

    Of a size parameter: a parabola through its typical size on both sides, or a line where its bounds allow
    but one (an effect such as a gap has no derivative at neutral, and matters at its typical size). Of a
    nuisance: the centred difference over one prior sigma.
    """
    zero = np.zeros(len(simulator.nuisances))
    nominal = simulator.predict({}, zero)
    of = sum(len(hypothesis.sizes) for hypothesis in simulator.hypotheses) + len(simulator.nuisances)
    effect: list[Array] = []
    curve: list[Array] = []
    nuisance: list[Array] = []
    owner: list[int] = []
    for index, hypothesis in enumerate(simulator.hypotheses):
        for at, parameter in enumerate(hypothesis.parameters):
            if parameter.sizes:
                slope, bend = _parabola(simulator, hypothesis, at, nominal)
                effect.append(slope)
                curve.append(bend)
                owner.append(index)
                step(len(effect), of)
    for index, uncertain in enumerate(simulator.nuisances):
        by = np.zeros_like(zero)
        by[index] = NUISANCE_STEP * (uncertain.sigma if np.isfinite(uncertain.sigma) else 1.0)
        nuisance.append((simulator.predict({}, by) - simulator.predict({}, -by)) / (2.0 * by[index]))
        step(len(effect) + len(nuisance), of)
    m = simulator.layout.size
    return Sensitivities(
        simulator.layout,
        simulator.hypotheses,
        simulator.nuisances,
        nominal,
        np.array(effect).reshape(-1, m).T,
        np.array(curve).reshape(-1, m).T,
        np.ones(len(curve)),
        np.array(owner, dtype=np.intp),
        np.array(nuisance).reshape(-1, m).T,
    )


def save(path: Path, found: Sensitivities) -> None:
    """Keep sensitivities in an .npz file that holds no code; BadOutput if it cannot be written."""
    layout = found.layout
    words = {
        "hypotheses": [asdict(hypothesis) for hypothesis in found.hypotheses],
        "nuisances": [asdict(nuisance) for nuisance in found.nuisances],
        "names": {name: getattr(layout, name) for name in _NAMES},
    }
    arrays = {name: getattr(layout, name) for name in _ARRAYS}
    arrays |= {name: getattr(found, name) for name in _FOUND}
    with written_whole(path, "sensitivities") as file:
        np.savez(file, words=np.array(json.dumps(words)), **arrays)


def load(path: Path) -> Sensitivities:
    """Sensitivities as they were kept; ValueError if the file does not hold any, or is cut or damaged."""
    try:
        return _loaded(path)
    except (OSError, EOFError, BadZipFile, zlib.error, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path}: no sensitivities ({error})") from error


def _loaded(path: Path) -> Sensitivities:
    with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
        missing = {"words", *_ARRAYS, *_FOUND} - set(file.files)
        if missing:
            raise ValueError(f"{', '.join(sorted(missing))} missing")
        words = json.loads(str(file["words"]))
        names = (tuple(words["names"][name]) for name in _NAMES)
        layout = Layout(*(file[name] for name in _ARRAYS), *names)
        hypotheses = tuple(
            Hypothesis(h["effect"], h["place"], tuple(Parameter(**p) for p in h["parameters"]))
            for h in words["hypotheses"]
        )
        nuisances = tuple(Nuisance(**nuisance) for nuisance in words["nuisances"])
        found = (file[name] for name in _FOUND)
        return Sensitivities(layout, hypotheses, nuisances, *found)


_ARRAYS: Final = ("sigma", "block", "channel", "place", "regime", "condition")
_FOUND: Final = ("nominal", "effect", "curve", "reach", "owner", "nuisance")
_NAMES: Final = ("blocks", "channels", "units", "places", "regimes", "conditions")


def _parabola(simulator: Simulator, hypothesis: Hypothesis, at: int, nominal: Array) -> tuple[Array, Array]:
    """Change of the features (m,) per typical size of one parameter and per its square, the others absent."""
    zero = np.zeros(len(simulator.nuisances))
    parameter, absent = hypothesis.parameters[at], hypothesis.absent
    ends: list[tuple[Array, float]] = []
    for sign in (1.0, -1.0):
        there = absent.copy()
        there[at] = np.clip(absent[at] + sign * parameter.typical, parameter.least, parameter.most)
        if there[at] != absent[at]:
            change = simulator.predict({hypothesis: there}, zero) - nominal
            ends.append((change, float((there[at] - absent[at]) / parameter.typical)))
    return through(ends)


def through(ends: Sequence[tuple[Array, float]]) -> tuple[Array, Array]:
    """Slope and bend at 0 of the parabola through 0 and two changes at their sizes; of one, a line."""
    (high, up), (low, down) = ends[0], ends[-1]
    bend = np.zeros_like(high) if up == down else (high / up - low / down) / (up - down)
    return high / up - bend * up, bend
