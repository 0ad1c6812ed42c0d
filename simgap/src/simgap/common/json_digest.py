"""Digest of a JSON document."""

import json
from hashlib import sha256
from typing import Any


def json_sha256(document: dict[str, Any]) -> str:
    """Compute the SHA-256 of a document, whatever its order and spaces."""
    text = json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return sha256(text.encode()).hexdigest()
