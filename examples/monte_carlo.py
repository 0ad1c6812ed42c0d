"""Sample a hundred arms, and estimate three sigma of their placement errors."""

import matplotlib.pyplot as plt
import numpy as np

from marsarm import MonteCarloRequest, run_monte_carlo

SIGMA = "three sigma, upper bound with 95 % confidence"


def main() -> None:
    """Run on all cores; the processes import this file, so the work is in a function."""
    report = run_monte_carlo(MonteCarloRequest(case="mars", arms=100, places=5, move_model="statics"))
    error_mm = 1e3 * np.array([[np.linalg.norm(one.error[3:]) for one in arm] for arm in report.trials])
    print(f"{len(report.trials)} arms, {len(report.failed)} failed")
    print(f"median {np.median(error_mm):.2f} mm, largest {error_mm.max():.2f} mm")

    figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
    axes.hist(error_mm.ravel(), bins=30)
    axes.set(title="Placements of a hundred arms", xlabel="error of the tool [mm]", ylabel="placements")
    if report.three_sigma is not None:
        bound_mm = 1e3 * report.three_sigma["total_m"].accuracy.upper
        axes.axvline(bound_mm, color="tab:red", label=f"{SIGMA}: {bound_mm:.1f} mm")
        axes.legend()
    figure.savefig("monte_carlo.png", dpi=100)


if __name__ == "__main__":
    main()
