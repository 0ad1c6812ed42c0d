"""Files that are made from the `arm.toml` of an arm: the MJCF of its plant and its flight parameters."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from rich.table import Table

from marsarm.arms.request import ArmBuildRequest
from sim.arm_check import check_arm
from sim.arm_model.description import BadArm
from sim.arm_model.load import ArmModel, arm_folder, arm_names, default_arm, load_arm
from sim.params_table import BadParams, full_params_toml
from simgap.common.console import plain_console
from simgap.common.errors import BadRequest
from simgap.common.files import atomic_write, check_output

MADE_FROM: Final = "Made from arm.toml by `marsarm arm build`; change that file, not this one."


@dataclass(frozen=True, slots=True)
class ArmFiles:
    """Arm with the files that are made from its description."""

    model: ArmModel
    texts: dict[Path, str]
    """Text of each file."""

    @property
    def stale(self) -> tuple[Path, ...]:
        """Return the files that are missing or have another text."""
        return tuple(
            path
            for path, text in self.texts.items()
            if not path.is_file() or path.read_bytes() != text.encode()
        )


def build_arms(request: ArmBuildRequest) -> tuple[ArmFiles, ...]:
    """Make the files of an arm, or of all arms of the project, and write those that have changed.

    Raises:
        BadRequest: there is no such arm, its description is wrong, it cannot be homed, or a file is stale and
            was to be checked.
    """
    try:
        names = arm_names() if request.arm is None else (request.arm,)
        found = tuple(_make_files(name) for name in names)
    except (BadArm, BadParams) as error:
        raise BadRequest(str(error)) from error
    stale = {path: one.texts[path] for one in found for path in one.stale}
    if request.check and stale:
        raise BadRequest(f"{next(iter(stale))}: is not what arm.toml says; run `marsarm arm build`")
    for path in stale:
        check_output(path, (path.suffix,), "file")
    for path, text in stale.items():
        with atomic_write(path, "file") as file:
            file.write(text.encode())
    return found


def _make_files(name: str) -> ArmFiles:
    model, folder = load_arm(name), arm_folder(name)
    check_arm(model)
    comments = [f"Flight parameters of the drawing of {model.description.title}.", MADE_FROM, "SI units."]
    return ArmFiles(
        model,
        {
            folder / "arm.xml": f"<!-- {MADE_FROM} -->\n{model.mjcf}",
            folder / "flight.toml": full_params_toml(model.params, comments),
        },
    )


def describe_arm(model: ArmModel) -> dict[str, Any]:
    """Describe an arm in a few numbers."""
    links = model.description.links.in_order()
    mass_kg = sum(link.far.mass_kg + (0.0 if link.near is None else link.near.mass_kg) for link in links)
    return {
        "name": model.name,
        "title": model.description.title,
        "upper_arm_m": links[2].transform.a_m,
        "forearm_m": links[3].transform.a_m,
        "mass_kg": round(mass_kg, 6),
        "tools": [*model.params.tool_names],
        "instrument": model.description.instrument,
        "sha256": model.params.model.sha256,
        "is_default": model.name == default_arm().name,
    }


def arms_table(models: Iterable[ArmModel]) -> None:
    """Print a line for each arm."""
    table = Table()
    for name in ("arm", "title", "upper arm m", "forearm m", "kg", "tools"):
        table.add_column(name, justify="right" if name.split()[-1] in ("m", "kg") else "left")
    for model in models:
        described = describe_arm(model)
        numbers = [f"{described[key]:g}" for key in ("upper_arm_m", "forearm_m", "mass_kg")]
        name = model.name + (" (default)" if described["is_default"] else "")
        table.add_row(name, model.description.title, *numbers, " ".join(described["tools"]))
    plain_console().print(table)


def files_table(found: Iterable[ArmFiles]) -> None:
    """Print the files that were made from each arm.toml."""
    for one in found:
        for path in one.texts:
            plain_console().print(f"{one.model.name}  {path}", soft_wrap=True)
