"""Write `docs/results.md` from `results/*.json`, and refresh the tables that other pages take from it.

    python scripts/results_page.py [--check]

Each file in `results/` is one table: `id`, `title`, `group`, `text` (the protocol), `command`, `data`, `digest` of the
data or null, `commit`, `date`, `seed` (a number, a list of numbers or null), `columns`, and `rows` of strings. A page
takes a table by a block, which this script fills. The first column is always shown:

    <!-- results: ID columns=overall accuracy,mean F1 rows=pool,general -->
    <!-- /results -->

In a sentence a figure is a link whose text is a cell of the table: `[0.86](results.md#ID)`. The page of results says of
each table whether its data are simulated or recorded, as `data` has it, and of each row of a method whether it is
printed, improved, a baseline or published. `--check` writes nothing and fails with the name of each stale page.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
GROUPS = {
    "objects": "Objects of the inventory",
    "lines": "Kerbs, wires and markings",
    "road": "The road",
    "points": "Labels of points",
    "methods": "Published methods",
    "studies": "Studies of the papers",
    "learning": "Learning from corrections",
    "simulation": "Simulator",
    "speed": "Time, memory and disk",
}
FIELDS = {"id", "title", "group", "text", "command", "data", "digest", "commit", "date", "seed", "columns", "rows"}
FORMS = {"commit": r"[0-9a-f]{7,40}", "date": r"\d{4}-\d{2}-\d{2}", "digest": r"sha256:[0-9a-f]{8,64}"}
ORIGINS = {
    "simulated": re.compile(r"simulat|street", re.IGNORECASE),
    "recorded": re.compile(
        r"record|Oakland|KITTI|PandaSet|nuScenes|\bika\b|Sydney|Taiwan|Amsterdam|Toronto|Paris|Michigan|RELLIS|ISPRS"
    ),
}
"""Words of `data` that say where the points come from."""
VERSIONS = {
    "†": re.compile(r"published|the paper"),
    "=": re.compile(r"\w*printed|rule on both|normalized_cut_plain"),
    "○": re.compile(
        r"patch_svm|patch_forest|shape_based|max_margin_markov|hough_forest|object_matching|bottom_up_top_down|shot|"
        r"hierarchy_descriptor|spin_image|pointnet|PointNet|yang_dong|two_step|hidden point removal"
    ),
    "+": re.compile(
        r"jointnet|\w+_net\b|patch_graph|visual_words|detrended_forest|pool|rule with|F1 of labels alone|depth buffer|"
        r"image_labels|normalized_cut|boosted_trees|superpoint_transformer|general\b"
    ),
}
"""How the first cell of a row of a method begins: figures of the papers (†), methods as in the text of the paper alone
(=), methods that the papers compare with (○), and methods with what this project adds or chooses (+)."""
BLOCK = re.compile(
    r"<!-- results: (?P<id>\w+)(?: columns=(?P<columns>[^\n]+?))?(?: rows=(?P<rows>[^\n]+?))? -->\n"
    r".*?<!-- /results -->",
    re.DOTALL,
)

Table = dict[str, Any]


def read_tables(folder: Path = ROOT / "results") -> dict[str, Table]:
    """Return the tables of a folder by id, sorted by file name.

    Raises
    ------
    ValueError
        A file lacks a field or has an unknown one, a value of the wrong form, or rows of unequal length.
    """
    tables = {}
    for path in sorted(folder.glob("*.json")):
        table = json.loads(path.read_text(encoding="utf-8"))
        for fault in _faults(table, path.stem):
            raise ValueError(f"{path.name}: {fault}")
        tables[path.stem] = table
    return tables


def _faults(table: Table, name: str) -> Iterator[str]:
    """Yield what is wrong with a table; what follows a fault is not reliable."""
    if set(table) != FIELDS:
        yield f"fields missing or unknown: {', '.join(sorted(set(table) ^ FIELDS))}"
    if table["id"] != name or not re.fullmatch(r"[a-z0-9_]+", name):
        yield f"id {table['id']!r} is not the name of the file, or has other characters than a-z, 0-9 and _"
    if table["group"] not in GROUPS:
        yield f"unknown group {table['group']!r} (known: {', '.join(GROUPS)})"
    for key in ("title", "text", "command", "data"):
        if not (isinstance(table[key], str) and table[key]):
            yield f"{key} is empty or not a string"
    for key, form in FORMS.items():
        if not (key == "digest" and table[key] is None) and not re.fullmatch(form, str(table[key])):
            yield f"{key} {table[key]!r} does not match {form}"
    seeds = table["seed"] if isinstance(table["seed"], list) else [table["seed"]]
    if not (table["seed"] is None or (seeds and all(type(seed) is int for seed in seeds))):
        yield f"seed {table['seed']!r} is not null, a number or a list of numbers"
    if table["group"] not in ("speed", "simulation") and not origin(table):
        yield f"data {table['data']!r} does not say whether they are simulated or recorded"
    columns, rows = table["columns"], table["rows"]
    if not rows or len(set(columns)) != len(columns):
        yield "no rows, or two columns of one name"
    for number, row in enumerate([columns, *rows]):
        if len(row) != len(columns) or not all(isinstance(cell, str) and "|" not in cell for cell in row):
            yield f"row {number}: {len(columns)} strings without | are needed"


def markdown_table(
    table: Table, columns: list[str] | None = None, rows: list[str] | None = None, bar: str = " | "
) -> str:
    """Return the table, or the first column with the chosen ones, of all rows or those with the given first cells."""
    first, *others = table["columns"]
    chosen = [first, *(name for name in (others if columns is None else columns) if name != first)]
    unknown = [name for name in chosen if name not in table["columns"]]
    unknown += [name for name in rows or [] if name not in {_plain(row[0]) for row in table["rows"]}]
    if unknown:
        raise ValueError(f"results/{table['id']}.json has no column or row {', '.join(map(repr, unknown))}")
    places = [table["columns"].index(name) for name in chosen]
    body = [[row[place] for place in places] for row in table["rows"] if rows is None or _plain(row[0]) in rows]
    head, *lines = [f"{bar.lstrip()}{bar.join(line)}{bar.rstrip()}" for line in [chosen, *body]]
    return "\n".join([head, f"|{'---|' * len(chosen)}", *lines])


def origin(table: Table) -> str:
    """Return where the points come from: simulated, recorded, simulated and recorded, or nothing."""
    return " and ".join(name for name, words in ORIGINS.items() if words.search(table["data"]))


def with_versions(table: Table) -> Table:
    """Return the table with a column that says which version of a method each row has, where rows are methods."""
    if table["group"] not in ("methods", "studies"):
        return table
    cells = [_plain(row[0]) for row in table["rows"]]
    versions = [next((name for name, start in VERSIONS.items() if start.match(cell)), "") for cell in cells]
    if not any(versions):
        return table
    columns = [table["columns"][0], "version", *table["columns"][1:]]
    rows = [[row[0], version, *row[1:]] for row, version in zip(table["rows"], versions, strict=True)]
    return table | {"columns": columns, "rows": rows}


def _plain(cell: str) -> str:
    return cell.strip("`*")


def gone_scripts(table: Table) -> list[str]:
    """Return the scripts of the command and data of a table that are not in the tree any more."""
    named = re.findall(r"\b(?:benchmarks|scripts)/\w+\.(?:py|sh)\b", f"{table['command']} {table['data']}")
    return sorted(name for name in set(named) if not (ROOT / name).exists())


def provenance(table: Table) -> str:
    """Return command, data, commit, date, seed and digest of a table in one line."""
    parts = [
        f"`{table['command']}`{' ‡' * bool(gone_scripts(table))}",
        table["data"],
        f"commit `{table['commit'][:9]}`, {table['date']}",
    ]
    if table["seed"] is not None:
        seeds = table["seed"] if isinstance(table["seed"], list) else [table["seed"]]
        row = len(seeds) > 2 and seeds == list(range(seeds[0], seeds[-1] + 1))
        listed = f"{seeds[0]}–{seeds[-1]}" if row else ", ".join(map(str, seeds))
        parts.append(f"seed{'s' if len(seeds) > 1 else ''} {listed}")
    if table["digest"] is not None:
        parts.append(f"`{table['digest'][:19]}`")
    return "; ".join(parts) + "."


def results_page(tables: dict[str, Table]) -> str:
    """Return the text of `docs/results.md`."""
    lines = [
        "# Results",
        "",
        "All figures of the manual, generated from `results/*.json` by `python scripts/results_page.py`. Commit and "
        "command are those with which a table was recorded; ‡: that commit alone has a script. Recordings lie below "
        "`$MLSROAD_DATA`.",
        "",
        "Versions of a method: = printed, by text and equations of its paper alone; + improved; ○ baseline of a paper; "
        "† published, of the paper's own data. Simulated and recorded data are not comparable.",
        "",
    ]
    groups = {group: [table for table in tables.values() if table["group"] == group] for group in GROUPS}
    for group, members in groups.items():
        if members:
            links = ", ".join(f"[{table['title']}](#{table['id']})" for table in members)
            lines.append(f"- **{GROUPS[group]}**: {links}.")
    for group, members in groups.items():
        if members:
            lines += ["", f"## {GROUPS[group]}"]
        for table in members:
            lines += ["", f'<a id="{table["id"]}"></a>', "", f"### {table['title']}", ""]
            lines += [
                " ".join([*([f"**{data.capitalize()}.**"] if (data := origin(table)) else []), table["text"]]),
                "",
            ]
            lines += [markdown_table(with_versions(table), bar="|"), "", provenance(table)]
    return "\n".join(lines) + "\n"


def refresh(text: str, tables: dict[str, Table], page: Path) -> str:
    """Return the text of a page with the blocks filled from the tables."""

    def fill(match: re.Match[str]) -> str:
        name = match["id"]
        if name not in tables:
            raise ValueError(f"{page}: there is no results/{name}.json")
        columns, rows = (match[key].split(",") if match[key] else None for key in ("columns", "rows"))
        head = match[0].partition("\n")[0]
        link = os.path.relpath(ROOT / "docs/results.md", page.parent)
        table = markdown_table(tables[name], columns, rows)
        return f"{head}\n{table}\n\n[Protocol]({link}#{name})\n<!-- /results -->"

    return BLOCK.sub(fill, text)


def pages(root: Path = ROOT) -> list[Path]:
    """Return the pages that may take figures: the README and the manual but the page of results."""
    return [root / "README.md", *(path for path in sorted((root / "docs").rglob("*.md")) if path.name != "results.md")]


def main() -> None:
    """Write the page and the blocks, or check them."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="write nothing; fail where a page is stale")
    check = parser.parse_args().check
    tables = read_tables()
    wanted = {ROOT / "docs/results.md": results_page(tables)}
    wanted |= {page: refresh(page.read_text(encoding="utf-8"), tables, page) for page in pages()}
    stale = [page for page, text in wanted.items() if not page.exists() or page.read_text(encoding="utf-8") != text]
    names = ", ".join(str(page.relative_to(ROOT)) for page in stale)
    if check and stale:
        sys.exit(f"stale: {names}; run python scripts/results_page.py")
    for page in stale:
        page.write_text(wanted[page], encoding="utf-8")
    sys.stdout.write(f"written: {names}\n" if stale else "up to date\n")


if __name__ == "__main__":
    main()
