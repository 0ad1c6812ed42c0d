"""Record an arm whose third link is 6 mm too long, and find that out from the logs."""

from pathlib import Path

import matplotlib.pyplot as plt

from marsarm import (
    DiagnoseRequest,
    RecordRequest,
    diagnose,
    effects_of_findings,
    record_logs,
    verdict_lines,
)

LOGS = Path("logs")


def main() -> None:
    """Run on all cores; the processes import this file, so the work is in a function."""
    record_logs(RecordRequest(LOGS, effects=("link-length:arm3.x:length_m=0.006",), sessions="poses-level-*"))
    request = DiagnoseRequest((LOGS,), (LOGS / "held-out",), catalogue="link-length", campaign=LOGS)
    result = diagnose(request)
    lines = [f"{label}: {text}" for label, text in verdict_lines(result)]
    print(*lines, *effects_of_findings(result), sep="\n")

    figure, (length, tool) = plt.subplots(1, 2, figsize=(8, 4), layout="constrained")
    for finding in result.diagnosis.findings:
        least, value, most = (1e3 * part[0] for part in (finding.least, finding.values, finding.most))
        length.errorbar(0, value, yerr=[[value - least], [most - value]], fmt="o", capsize=8, label="found")
    length.axhline(6.0, color="gray", linestyle=":", label="truth")
    length.legend()
    length.set(title="Length of link 3", ylabel="fitted error, 90 % interval [mm]", xticks=[])
    if result.tool is not None:
        heights = (result.tool.before_mm, result.tool.after_mm, result.tool.noise_floor_mm)
        tool.bar(["without", "with the finding", "noise floor"], heights)
    tool.set(title="Tool on held-out motion", ylabel="error, root mean square [mm]")
    figure.savefig("arm_diagnosis.png", dpi=100)


if __name__ == "__main__":
    main()
