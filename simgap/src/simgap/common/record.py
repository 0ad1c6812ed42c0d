"""Records of TOML files, whose docstrings describe their keys."""

from pydantic import BaseModel, ConfigDict


class Record(BaseModel):
    """Table of a TOML file: no unknown keys, no conversion of types, only finite numbers."""

    model_config = ConfigDict(
        extra="forbid", strict=True, frozen=True, allow_inf_nan=False, use_attribute_docstrings=True
    )
