"""Plot the cost of a diagnosis against the length of the log and the number of effects: docs/robot-cost.png.

Cases of the pendulum and of the arm with two joints are drawn from tuning seeds; motions are left out at the
end. Costs are CPU seconds of one process.
"""

import json
import sys
import time
from pathlib import Path
from typing import Any, Final

from matplotlib.figure import Figure

from diagnosis.diagnose import diagnose
from diagnosis.logs import Logs
from validation.options import campaign_parser
from validation.robot_cases.draw import Kind, draw_case
from validation.robot_cases.motions import PERIOD_S, SAMPLES

EXAMPLE: Final = "example: python -m validation.robot_cost --out docs/robot-cost.png"
MODELS: Final = ("pendulum", "two_joint")
KINDS: Final[tuple[Kind, ...]] = ("none", "single", "pair")
FITTED: Final = (4, 6, 8)
"""Numbers of fitted motions; a diagnosis needs four."""


def measure(model: str, kind: Kind, motions: int, seed: int) -> dict[str, Any]:
    """Diagnose a case of which this many motions are fitted; return its cost."""
    robot, logs, _ = draw_case(seed, kind, model)
    fitted = Logs(logs.fit[:motions])
    began = time.process_time()
    found = diagnose(robot, fitted.motions, held_out=logs.judged, seed=1)
    return {
        "model": model,
        "effects": KINDS.index(kind),
        "log_s": motions * SAMPLES * PERIOD_S,
        "cpu_s": time.process_time() - began,
        "findings": len(found.findings),
    }


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    """Plot a panel a model, and a line a number of effects."""
    figure = Figure(figsize=(8.0, 3.4), layout="constrained")
    for model, axes in zip(MODELS, figure.subplots(1, len(MODELS), sharey=True), strict=True):
        for effects in range(len(KINDS)):
            mine = [row for row in rows if (row["model"], row["effects"]) == (model, effects)]
            label = f"{effects} effect{'' if effects == 1 else 's'}"
            axes.plot([row["log_s"] for row in mine], [row["cpu_s"] for row in mine], "o-", label=label)
        axes.set_title(model.replace("_", " "))
        axes.set_xlabel("fitted log [s]")
        axes.set_ylim(bottom=0.0)
        axes.legend()
        axes.grid(alpha=0.3)
    figure.axes[0].set_ylabel("cost [CPU s]")
    figure.savefig(path, dpi=150)


def main() -> int:
    """Measure, plot and print the costs as JSON."""
    parser = campaign_parser("robot_cost", __doc__, EXAMPLE, with_pool=False)
    parser.add_argument("--out", type=Path, default=Path("docs/robot-cost.png"))
    options = parser.parse_args()
    rows = []
    for model in MODELS:
        for kind in KINDS:
            for motions in FITTED:
                rows.append(measure(model, kind, motions, options.seed))
                print(json.dumps(rows[-1]), flush=True)
    plot(rows, options.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
