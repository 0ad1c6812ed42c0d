"""Plot the cost of a diagnosis against the length of the log and the number of effects: docs/robot-cost.png.

Cases of the pendulum and of the arm with two joints are drawn from tuning seeds; motions are left out at the
end. Costs are CPU seconds of one process. With --results, an interrupted campaign goes on.
"""

import json
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, Final

from marsarm.render.svg import save_figure
from simgap.common.errors import UserError
from simgap.common.progress import show_progress
from simgap.diagnosis import diagnose
from simgap.selection.checkpoint import Progress
from validation.options import campaign_parser
from validation.resumable import keep_results
from validation.robot_cases.draw import Kind, draw_case
from validation.robot_cases.motions import PERIOD_S, SAMPLES

EXAMPLE: Final = "example: python -m validation.robot_cost --out docs/robot-cost.png"
MODELS: Final = {"pendulum": "pendulum", "two_joint": "arm with two joints"}
KINDS: Final[tuple[Kind, ...]] = ("none", "single", "pair")
FITTED: Final = (4, 6, 8)
"""Numbers of fitted motions; a diagnosis needs four."""
DIAGNOSIS_SEED: Final = 1
"""Seed of the diagnosis, independent of that of the cases."""


@dataclass(frozen=True, slots=True)
class Setting:
    """Case, and the number of its motions that are fitted."""

    model: str
    kind: Kind
    motions: int

    @property
    def name(self) -> str:
        return f"{self.model}, {self.kind}, {self.motions} motions"


SETTINGS: Final = tuple(Setting(*one) for one in product(MODELS, KINDS, FITTED))


def measure(setting: Setting, seed: int, progress: Progress) -> dict[str, Any]:
    """Diagnose a case; return its cost."""
    robot, logs, _ = draw_case(seed, setting.kind, setting.model)
    began = time.process_time()
    found = diagnose(
        robot, logs.fit[: setting.motions], held_out=logs.judged, seed=DIAGNOSIS_SEED, progress=progress
    )
    return {
        "model": setting.model,
        "effects": KINDS.index(setting.kind),
        "log_s": setting.motions * SAMPLES * PERIOD_S,
        "cpu_s": time.process_time() - began,
        "findings": len(found.findings),
    }


def measure_all(settings: Sequence[Setting], seed: int, results: Path | None) -> list[dict[str, Any]]:
    """Measure settings that have no result yet; tell the time left."""
    rows = []
    with keep_results(results, seed) as once, show_progress() as progress:
        for done, setting in enumerate(settings):

            def tell(share: float, text: str, done: int = done, name: str = setting.name) -> None:
                progress(done + share, len(settings), f"{name}: {text}")

            rows.append(once(setting.name, partial(measure, setting, seed, tell)))
    return rows


def plot(rows: list[dict[str, Any]], figure: Any) -> None:
    """Plot a panel a model, and a line a number of effects."""
    for model, axes in zip(MODELS, figure.subplots(1, len(MODELS), sharey=True), strict=True):
        for effects in range(len(KINDS)):
            mine = [row for row in rows if (row["model"], row["effects"]) == (model, effects)]
            label = f"{effects} effect{'' if effects == 1 else 's'}"
            if mine:
                axes.plot([row["log_s"] for row in mine], [row["cpu_s"] for row in mine], "o-", label=label)
        axes.set_title(MODELS[model])
        axes.set_xlabel("fitted log [s]")
        axes.set_xlim(0.0, 1.05 * FITTED[-1] * SAMPLES * PERIOD_S)
        if axes.lines:
            axes.legend(loc="upper left")
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("cost [CPU s]")
    figure.axes[0].set_ylim(bottom=0.0)  # after the last panel, because it ends the common scaling


def main() -> int:
    """Measure, plot and print the costs as JSON."""
    parser = campaign_parser("robot_cost", __doc__, EXAMPLE, with_pool=False)
    parser.add_argument("--out", type=Path, help="PNG of the plot")
    parser.add_argument("--results", type=Path, help="file of costs, from which the campaign goes on")
    parser.add_argument("--settings", type=int, default=len(SETTINGS), help="measure the first ones only")
    options = parser.parse_args()
    try:
        rows = measure_all(SETTINGS[: options.settings], options.seed, options.results)
        if options.out is not None:
            save_figure(options.out, (8.0, 3.4), 150, partial(plot, rows))
    except UserError as error:
        print(error, file=sys.stderr)
        return 2
    print(json.dumps(rows, indent=2))
    return 0


if __name__ == "__main__":
    sys.exit(main())
