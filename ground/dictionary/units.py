"""The unit of a field, from the suffix of its name."""

from typing import Final

SYMBOLS: Final = {
    "rad": "rad",
    "urad": "urad",
    "m": "m",
    "s": "s",
    "A": "A",
    "N": "N",
    "Nm": "N m",
    "C": "degC",
    "K": "K",
    "J": "J",
    "kg": "kg",
    "Hz": "Hz",
    "Pa": "Pa",
    "V": "V",
    "W": "W",
    "count": "count",
    "1": "1",
    "s2": "s2",
    "s3": "s3",
}
"""By a part of the suffix."""

NUMBERS: Final = {
    "tick": "cycle",
    "cycle": "cycle",
    "cycles": "cycle",
    "persistence": "cycle",
    "period": "cycle",
    "turn": "count",
    "share": "1",
    "fraction": "1",
    "ratio": "1",
    "factor": "1",
    "side": "1",
    "along": "1",
    "across": "1",
}
"""By the last word of a name without a unit: what is counted, or 1 for a pure number."""

DIRECTIONS: Final = ("approach", "gravity", "normal", "R")
"""First words of names of directions and rotations, whose components are pure numbers."""

FREE: Final = {
    "compliance": "mixed",
    "value": "of the parameter",
    "bound": "cycle",
}
"""Names whose unit their text, or their fellow, says."""


def unit_of(name: str) -> str | None:
    """The unit that a field's name tells, "1" for a pure number, or None where it tells none."""
    words = name.split("_")
    suffix: list[str] = []
    while words and words[-1] in SYMBOLS and len(suffix) < 2:
        suffix.insert(0, SYMBOLS[words.pop()])
    if suffix:
        top, *below = suffix
        return top if not below else f"{top}/{below[0] if ' ' not in below[0] else f'({below[0]})'}"
    if words[-1] in NUMBERS:
        return NUMBERS[words[-1]]
    return "1" if words[0] in DIRECTIONS else FREE.get(name)
