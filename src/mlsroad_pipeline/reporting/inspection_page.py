"""Report on the files of a survey: warnings, facts as plain data, and an HTML page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from mlsroad_pipeline.reporting.figures.survey import survey_map_figure
from mlsroad_pipeline.reporting.html.report import (
    FactsSection,
    FiguresSection,
    Section,
    TableSection,
    WarningsSection,
    build_report,
)
from mlsroad_pipeline.surveys.inspection import FileInspection

ASPRS = {
    **{0: "never classified", 1: "unclassified", 2: "ground", 3: "low vegetation", 4: "medium vegetation"},
    **{5: "high vegetation", 6: "building", 7: "low noise", 8: "model key point", 9: "water", 10: "rail"},
    **{11: "road surface", 13: "wire guard", 14: "wire conductor", 15: "transmission tower", 16: "wire connector"},
    **{17: "bridge deck", 18: "high noise"},
}
"""Names of the standard codes of `classification` in LAS files."""

MOST_PICTURES = 12
"""Maximum number of maps in the report."""

MANY = 4
"""Number of files from which a shared warning is listed once."""


def survey_warnings(files: Sequence[FileInspection], unread: Mapping[str, str]) -> pd.DataFrame:
    """Return the warnings of all files, and those on differences between files."""
    rows = [(name, f"cannot be read: {reason}") for name, reason in unread.items()]
    rows += _gathered([(file.name, warning) for file in files for warning in file.warnings], len(files))
    systems = {file.info.crs: file.name for file in reversed(files)}
    if len(systems) > 1:
        examples = "; ".join(f"{name}: {crs_label(crs)}" for crs, name in systems.items())
        rows.append((files[0].name, f"files have different coordinate reference systems ({examples})"))
    columns: dict[tuple[str, ...], str] = {}
    for file in files:
        columns.setdefault(tuple(sorted(file.facts["columns"])), file.name)
    if len(columns) > 1:
        n_files = Counter(name for names in columns for name in names)
        some = sorted(name for name, count in n_files.items() if count < len(columns))
        rows.append((files[0].name, f"only some of the files have {', '.join(some)}"))
    return pd.DataFrame(rows, columns=["file", "warning"])


def _gathered(rows: Sequence[tuple[str, str]], n_files: int) -> list[tuple[str, str]]:
    """Return the warnings with those shared by many files merged into one."""
    names: dict[str, list[str]] = {}
    for name, warning in rows:
        names.setdefault(warning, []).append(name)
    return [
        (
            f"{len(names[warning])} of {n_files} files, the first {name}" if len(names[warning]) >= MANY else name,
            warning,
        )
        for name, warning in rows
        if len(names[warning]) < MANY or name == names[warning][0]
    ]


def crs_label(crs: str | None) -> str:
    """Return a short name of a CRS for messages."""
    return "none" if crs is None else crs.partition('"')[2].partition('"')[0] or crs[:40]


def survey_facts(survey: str, files: Sequence[FileInspection], warnings: pd.DataFrame) -> dict[str, Any]:
    """Return the facts of a survey as plain data."""
    return {
        "survey": survey,
        "n_points": sum(file.facts["n_points"] for file in files),
        "files": [file.facts for file in files],
        "warnings": warnings.to_dict("records"),
    }


def survey_page(survey: str, files: Sequence[FileInspection], warnings: pd.DataFrame) -> str:
    """Return the report as an HTML page."""
    facts = [file.facts for file in files]
    systems = sorted({fact["crs_name"] or "none" for fact in facts})
    summary = {
        "files": len(files),
        "points": sum(fact["n_points"] for fact in facts),
        "size, MB": sum(fact["bytes"] for fact in facts) / 1e6,
        "formats": ", ".join(sorted({_kind(fact) for fact in facts})) or "none",
        "coordinate reference system": ", ".join(systems) or "none",
    }
    messages = [f"{row.file}: {row.warning}" for row in warnings.itertuples()]
    pictures = {f"{file.name}": survey_map_figure(file.picture) for file in files[:MOST_PICTURES]}
    some = f": the first {MOST_PICTURES} of {len(files)} files" if len(files) > MOST_PICTURES else ""
    sections: list[Section] = [
        FactsSection("Survey", summary),
        WarningsSection("Warnings", messages),
        TableSection("Files", pd.DataFrame([_file_row(fact) for fact in facts])),
        FiguresSection(f"From above{some}", pictures),
        TableSection("Columns", pd.DataFrame([row for fact in facts for row in _column_rows(fact)])),
        TableSection("Times and scan lines", pd.DataFrame([_time_row(fact) for fact in facts])),
        TableSection("Codes", pd.DataFrame([row for fact in facts for row in _code_rows(fact)])),
    ]
    return build_report(sections, title="Survey inspection", subtitle=survey)


def _kind(fact: Mapping[str, Any]) -> str:
    details = fact["details"]
    if fact["format"] != "LAS":
        return str(fact["format"])
    return f"{'LAZ' if details['compressed'] else 'LAS'} {details['version']}, point format {details['point_format']}"


def _file_row(fact: Mapping[str, Any]) -> dict[str, Any]:
    row = {"file": fact["file"], "format": _kind(fact), "points": fact["n_points"], "points per m²": fact["density"]}
    for i, axis in enumerate("xyz"):
        row[f"{axis} from"], row[f"{axis} to"] = fact["low"][i], fact["high"][i]
    row["duplicates"] = f"{'' if fact['duplicates_exact'] else 'about '}{fact['n_duplicates']}"
    return row


def _column_rows(fact: Mapping[str, Any]) -> list[dict[str, Any]]:
    return [
        {"file": fact["file"], "column": name, **{key: value for key, value in column.items() if key != "counts"}}
        for name, column in fact["columns"].items()
    ]


def _time_row(fact: Mapping[str, Any]) -> dict[str, Any]:
    return {"file": fact["file"], **fact["time"], **fact["scan_lines"]}


def _code_rows(fact: Mapping[str, Any]) -> list[dict[str, Any]]:
    return [
        {
            **{"file": fact["file"], "column": name, "code": int(code)},
            "meaning": ASPRS.get(int(code), "") if name == "classification" else "",
            **{"points": count, "share, %": 100.0 * count / max(fact["n_points"], 1)},
        }
        for name, column in fact["columns"].items()
        for code, count in column.get("counts", {}).items()
    ]
