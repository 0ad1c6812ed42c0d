"""Requirements of the paper: the campaigns that measure them, their tests, and docs/requirements.md.

Numbers that were measured stay in measured.json.
"""

import ast
import json
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from importlib import import_module
from math import degrees, isclose
from pathlib import Path
from typing import Any, Final

from simgap.common.origin import git_revision
from simgap.common.toml import read_toml
from validation.campaigns import Context, Document

ROOT: Final = Path(__file__).parents[1]
SOURCE: Final = Path(__file__).with_name("requirements.toml")
MEASURED: Final = Path(__file__).with_name("measured.json")
PAGE: Final = ROOT / "docs" / "requirements.md"
ALL: Final = "*"
SI_TO: Final = {("m", "mm"): 1e3, ("rad", "deg"): degrees(1.0)}
"""Factor from the unit at the end of the name of a constant to that of a requirement."""
HEAD: Final = """# Requirements
Each requirement of Collins and Robinson (2013; see [README](../README.md#where-the-numbers-come-from)).
The campaign measures the number. The tests check the method, or a smaller case. The margin is the distance
from the bound as a share of it. `make lint` checks this page: every test exists, {constants} bounds equal
those of the code, and the command below measured every number. The other bounds stand only here.
`make campaign NAME=requirements` measures all numbers anew.
"""


@dataclass(frozen=True, slots=True)
class MeasuringCampaign:
    """Command that measures some requirements."""

    name: str
    command: str
    """Command line of Python, which prints a JSON document."""
    about: str
    """Arms and poses that the numbers rest on."""


@dataclass(frozen=True, slots=True)
class RequirementRow:
    """Requirement, its bound, and how it is measured."""

    name: str
    source: str
    unit: str
    campaign: str
    value: tuple[str | int, ...]
    """Keys in the document of the campaign; ALL for every part, of which the worst counts."""
    tests: tuple[str, ...]
    most: float | None = None
    least: float | None = None
    factor: float = 1.0
    constant: str = ""
    """Constant that is the same bound, in SI units or those of its name: FILE:NAME or FILE:CLASS.FIELD."""
    paper: float | None = None
    """The paper's own value."""
    why: str = ""
    """Reason of the difference from the paper's value."""

    @property
    def bound(self) -> float:
        """Greatest or least value that is allowed."""
        bound = self.most if self.least is None else self.least
        assert bound is not None, f"{self.name}: most or least is missing"
        return bound

    def measure(self, document: Any) -> float:
        """Take the worst value out of the document of the campaign."""
        found = [self.factor * value for value in select(document, self.value)]
        return max(found) if self.least is None else min(found)

    def margin(self, value: float) -> float:
        """Return the distance from the bound as a share of it; negative if the requirement is not met."""
        left = self.bound - value if self.least is None else value - self.bound
        return left / self.bound


@dataclass(frozen=True, slots=True)
class RequirementTable:
    """All requirements with their campaigns."""

    campaigns: tuple[MeasuringCampaign, ...]
    rows: tuple[RequirementRow, ...]


def load_table(path: Path = SOURCE) -> RequirementTable:
    """Read the file of requirements."""
    content = read_toml(path)
    campaigns = tuple(MeasuringCampaign(name, **fields) for name, fields in content["campaign"].items())
    rows = tuple(
        RequirementRow(**{**fields, "value": tuple(fields["value"]), "tests": tuple(fields["tests"])})
        for fields in content["requirement"]
    )
    return RequirementTable(campaigns, rows)


def select(document: Any, keys: Sequence[str | int]) -> Iterator[float]:
    """Yield the numbers at these keys of a document."""
    if not keys:
        yield float(document)
    elif keys[0] == ALL:
        for part in document.values() if isinstance(document, dict) else document:
            yield from select(part, keys[1:])
    else:
        yield from select(document[keys[0]], keys[1:])


def measure(table: RequirementTable, campaign: MeasuringCampaign) -> dict[str, float]:
    """Run a campaign, and return its values by requirement; RuntimeError if it printed no JSON document."""
    words = shlex.split(campaign.command)
    command = [sys.executable, *words[1:]]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
    try:
        document = json.loads(done.stdout)
    except ValueError as error:
        raise RuntimeError(f"{campaign.command}: printed no JSON, status {done.returncode}") from error
    return {row.name: row.measure(document) for row in table.rows if row.campaign == campaign.name}


def find_problems(table: RequirementTable, measured: dict[str, Any]) -> Iterator[str]:
    """Yield a sentence for each test, constant, campaign or number that does not fit."""
    names = {campaign.name for campaign in table.campaigns}
    for row in table.rows:
        if row.campaign not in names:
            yield f"{row.name}: no campaign is called {row.campaign}"
        elif row.name not in measured.get(row.campaign, {}).get("values", {}):
            yield f"{row.name}: was not measured; run `python -m validation requirements`"
        if not row.tests:
            yield f"{row.name}: no test shows it"
        for test in row.tests:
            if not has_test(test):
                yield f"{row.name}: there is no test {test}"
        if row.constant:
            found = read_constant(row.constant)
            suffix = row.constant.rpartition("_")[2].lower()
            if found is None or not isclose(found * SI_TO.get((suffix, row.unit), 1.0), row.bound):
                yield f"{row.name}: the bound is {row.bound} {row.unit}, but {row.constant} is {found}"
    for name, kept in measured.items():
        wanted = next((one.command for one in table.campaigns if one.name == name), None)
        if kept["command"] != wanted:
            yield f"campaign {name}: was measured by another command; run `python -m validation requirements`"


def has_test(test: str) -> bool:
    """Check whether a test exists: FILE, or FILE::FUNCTION."""
    path, _, name = test.partition("::")
    file = ROOT / path
    if not file.is_file():
        return False
    tree = ast.parse(file.read_text(encoding="utf-8"))
    return not name or any(isinstance(one, ast.FunctionDef) and one.name == name for one in tree.body)


def read_constant(place: str) -> float | None:
    """Read a number: FILE:NAME, or FILE:CLASS.FIELD for the default of a field; None if there is none."""
    file, _, names = place.partition(":")
    name, _, field = names.partition(".")
    found = getattr(import_module(file.removesuffix(".py").replace("/", ".")), name, None)
    if found is not None and field:
        found = next((one.default for one in fields(found) if one.name == field), None)
    return None if found is None else float(found)


def make_page(table: RequirementTable, measured: dict[str, Any]) -> str:
    """Make the page."""
    values = {row.name: measured[row.campaign]["values"][row.name] for row in table.rows}

    def cells(rows: Iterable[RequirementRow], *more: Callable[[RequirementRow], str]) -> list[str]:
        results = ((row, f"| {row.name} | {row.source} | {_result(row, values[row.name])}") for row in rows)
        return [" | ".join([result, *(one(row) for one in more), ""]).rstrip() for row, result in results]

    def tests(row: RequirementRow) -> str:
        files = dict.fromkeys(test.partition("::")[0] for test in row.tests)
        return ", ".join(f"[{Path(file).stem}](../{file})" for file in files)

    of_paper = [row for row in table.rows if row.paper is not None]
    lines = [
        HEAD.format(constants=sum(bool(row.constant) for row in table.rows)),
        "| requirement | source | bound | measured | margin | campaign | tests of the method |",
        "|---|---|---|---|---|---|---|",
        *cells(
            (row for row in table.rows if row.paper is None),
            lambda row: f"[{row.campaign}](#campaigns)",
            tests,
        ),
        "",
        "## Tables 3 and 4 of the paper",
        f"Campaign {', '.join(dict.fromkeys(row.campaign for row in of_paper))}, "
        f"{', '.join(dict.fromkeys(map(tests, of_paper)))}.",
        "",
        "| requirement | source | bound | measured | margin | paper | ours over paper | why |",
        "|---|---|---|---|---|---|---|---|",
        *cells(
            of_paper,
            lambda row: f"{row.paper:g} {row.unit}",
            lambda row: f"{values[row.name] / (row.paper or 1.0):.2f}",
            lambda row: row.why,
        ),
    ]
    lines += ["", "## Campaigns", "| name | what is measured | command | commit |", "|---|---|---|---|"]
    for campaign in table.campaigns:
        commit = measured[campaign.name]["commit"]
        commit = commit[:7] + commit[40:]  # "-dirty" stays: nobody can repeat such a number
        lines.append(f"| {campaign.name} | {campaign.about} | `{campaign.command}` | `{commit}` |")
    met = sum(row.margin(values[row.name]) >= 0 for row in table.rows)
    as_paper = sum(row.paper is not None and row.margin(row.paper) < 0 for row in table.rows)
    told = f"{met} of {len(table.rows)} requirements are met."
    lines += ["", f"{told} The paper's own budget misses {as_paper} of them.", ""]
    return "\n".join(lines).replace("  |", " |")


def _result(row: RequirementRow, value: float) -> str:
    margin = row.margin(value)
    sign = "≤" if row.least is None else "≥"
    left = f"{'' if margin >= 0 else '**not met**, '}{int(100 * margin)} %"
    return f"{sign} {row.bound:g} {row.unit} | {value:.3g} {row.unit} | {left}"


def campaign(context: Context, measure_anew: bool = True, check: bool = False, only: str = "") -> Document:
    """Measure the requirements, and write their page; in bounds if there is no problem.

    The campaigns, all or those named with commas, run for half an hour; else the numbers that were measured
    stay. A check writes nothing.
    """
    table = load_table()
    kept = json.loads(MEASURED.read_text(encoding="utf-8"))
    names, commit = [one.name for one in table.campaigns], git_revision()
    chosen = [one for one in table.campaigns if one.name in (only.split(",") if only else names)]
    for number, one in enumerate(chosen if measure_anew and not check else ()):
        context.progress(number, len(chosen), one.name)
        kept[one.name] = {"commit": commit, "command": one.command, "values": measure(table, one)}
        ordered = {name: kept[name] for name in names if name in kept}
        MEASURED.write_text(json.dumps(ordered, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    problems = list(find_problems(table, kept))
    if not problems:
        page = make_page(table, kept)
        if not check:
            PAGE.write_text(page, encoding="utf-8")
        elif not PAGE.exists() or PAGE.read_text(encoding="utf-8") != page:
            problems.append("docs/requirements.md is not up to date; run `python -m validation requirements`")
    if problems:
        print("\n".join(problems), file=sys.stderr)
    return {"requirements": len(table.rows), "problems": problems, "in_bounds": not problems}
