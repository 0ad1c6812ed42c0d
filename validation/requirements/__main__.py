"""Write docs/requirements.md from the requirements and the numbers that campaigns measured.

`--check` changes nothing: it fails if the page is not up to date, a named test does not exist, or a bound is
not that of its constant. `--measure` first runs the campaigns, for half an hour, and stores their numbers.
"""

import json
import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter

from simgap.common.origin import git_revision
from validation.requirements.table import MEASURED, PAGE, find_problems, load_table, make_page, measure


def main() -> int:
    """Write or check the page; return 1 if there is a problem."""
    table = load_table()
    parser = ArgumentParser(
        "python -m validation.requirements",
        description=__doc__,
        epilog="example: python -m validation.requirements --measure --only hardstops",
        formatter_class=RawDescriptionHelpFormatter,
    )
    names = [campaign.name for campaign in table.campaigns]
    parser.add_argument("--check", action="store_true", help="only say what is wrong")
    parser.add_argument("--measure", action="store_true", help="run the campaigns first")
    parser.add_argument("--only", choices=names, action="append", help="measure only this; repeatable")
    options = parser.parse_args()
    kept = json.loads(MEASURED.read_text(encoding="utf-8")) if MEASURED.exists() else {}
    chosen = [one for one in table.campaigns if one.name in (options.only or names)]
    commit = git_revision()
    for number, campaign in enumerate(chosen if options.measure else (), 1):
        print(f"{campaign.name}: campaign {number} of {len(chosen)}", file=sys.stderr)
        values = measure(table, campaign)
        kept[campaign.name] = {"commit": commit, "command": campaign.command, "values": values}
        ordered = {name: kept[name] for name in names if name in kept}
        MEASURED.write_text(json.dumps(ordered, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    problems = list(find_problems(table, kept))
    if not problems:
        page = make_page(table, kept)
        if not options.check:
            PAGE.write_text(page, encoding="utf-8")
        elif not PAGE.exists() or PAGE.read_text(encoding="utf-8") != page:
            problems.append("docs/requirements.md is not up to date; run `python -m validation.requirements`")
    print("\n".join(problems) or f"requirements: {len(table.rows)} in order")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
