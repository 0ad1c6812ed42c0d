"""Record an arm whose third link is 6 mm too long, and find that out from the logs."""

from pathlib import Path

import matplotlib.pyplot as plt

from marsarm import DiagnoseRequest, RecordRequest, diagnose, effects_of_findings, record_logs
from simgap import verdict_lines

LOGS = Path("logs")


def main() -> None:
    """Run on all cores; the processes import this file, so the work is in a function."""
    record_logs(RecordRequest(LOGS, effects=("link-length:arm3.x:length_m=0.006",), sessions="poses-level-*"))
    request = DiagnoseRequest((LOGS,), (LOGS / "held-out",), catalogue="link-length", campaign=LOGS)
    found = diagnose(request).diagnosis
    print(*verdict_lines(found), *effects_of_findings(found), sep="\n")

    figure, (length, tool) = plt.subplots(1, 2, figsize=(8, 4), layout="constrained")
    for finding in found.findings:
        low, value, high = (
            1e3 * length_m for length_m in (finding.interval[0][0], finding.size[0], finding.interval[0][1])
        )
        length.errorbar(0, value, yerr=[[value - low], [high - value]], fmt="o", capsize=8, label="found")
    length.axhline(6.0, color="gray", linestyle=":", label="truth")
    length.legend()
    length.set(title="Length of link 3", ylabel="fitted error, 90 % interval [mm]", xticks=[])
    for one in found.errors:
        if one.joint == "tool":
            heights_mm = [1e3 * length_m for length_m in (one.base, one.explained, one.noise_floor)]
            tool.bar(["without", "with the finding", "noise floor"], heights_mm)
    tool.set(title="Tool on held-out motion", ylabel="error, root mean square [mm]")
    figure.savefig("arm_diagnosis.png", dpi=100)


if __name__ == "__main__":
    main()
