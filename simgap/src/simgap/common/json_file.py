"""JSON files that must have a type: read strictly, refused in one line."""

from pathlib import Path
from typing import TypeVar

from pydantic import TypeAdapter, ValidationError

from simgap.common.errors import BadRequest

T = TypeVar("T")


def read_json(path: Path, adapter: TypeAdapter[T], otherwise: str, advice: str) -> T:
    """Read a JSON file strictly as a type.

    Args:
        path: The file.
        otherwise: What is said of a file of another type, such as "holds no keys".
        advice: What the user can do.

    Returns:
        The document.

    Raises:
        BadRequest: The file cannot be read, or has another type.
    """
    try:
        return adapter.validate_json(path.read_bytes(), strict=True)
    except OSError as error:
        raise BadRequest(f"{path}: cannot be read ({error.strerror}); {advice}") from error
    except ValidationError as error:
        raise BadRequest(f"{path}: {otherwise} ({describe_first_problem(error)}); {advice}") from error


def describe_first_problem(error: ValidationError) -> str:
    """Return the first problem of a document in one line: where it is, and what it is."""
    first = error.errors()[0]
    where = ".".join(map(str, first["loc"]))
    return f"{where}: {first['msg']}" if where else str(first["msg"])
