"""Digest of the parameters, which names them in logs and reports."""

import hashlib
from dataclasses import fields, is_dataclass
from functools import cache

from fsw.dictionary.params import Params


def digest(params: Params) -> str:
    """Compute the SHA-256 of the parameter values; equal values give equal digests."""
    return hashlib.sha256(_canonical_text(params).encode()).hexdigest()


def _canonical_text(value: object) -> str:
    """Convert a value to the one text that all equal values share."""
    if is_dataclass(value):
        return "".join(
            [f"{name}={_canonical_text(getattr(value, name))};" for name in _field_names(value.__class__)]
        )
    if isinstance(value, tuple):
        return f"({','.join(_canonical_text(item) for item in value)})"
    return float(value).hex() if isinstance(value, float) else str(value)


@cache
def _field_names(record: type) -> tuple[str, ...]:
    return tuple(field.name for field in fields(record))
