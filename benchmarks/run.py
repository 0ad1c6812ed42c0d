"""All benchmarks that fit in a minute or two, as one JSON document on standard output."""

import json
import platform

from benchmarks.closed_loop import closed_loop


def main() -> None:
    """Measure and print."""
    machine = {"python": platform.python_version(), "machine": platform.machine()}
    print(json.dumps({"machine": machine, "closed_loop": closed_loop()}, indent=2))


if __name__ == "__main__":
    main()
