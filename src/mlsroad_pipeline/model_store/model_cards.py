"""Cards of the models in the package, generated from their registry entries."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_TITLES = {"arrays.npz": "trees", "model.json": "classes, parameters, features"}


def model_card(entry: Mapping[str, Any]) -> str:
    """Return the card of a model as Markdown."""
    attributes = " and ".join(entry["attributes"]) or "no attributes"
    lines = [
        f"# Model `{entry['name']}`",
        "",
        f"{entry['summary']}. Method: `{entry['method']}`. Licence: {entry['licence']}.",
        "",
        f"- **Input**: coordinates in metres, z up; {attributes} where a survey has them.",
        f"- **Classes**: {', '.join(entry['classes'])}.",
        f"- **Trained on**: {len(entry['training'])} simulated streets and {_recorded(entry['recordings'])};",
        f"  {entry['samples']} samples.",
        f"- **Command**: `{entry['command']}` (mlsroad_pipeline {entry['version']}).",
        "",
        "## Scores",
        "",
        *_scores(entry["scores"]),
        "",
        "## Training streets",
        "",
        "| name | preset | seed | length, m | other parameters of the simulator |",
        "|---|---|---|---|---|",
        *(_street(name, config) for name, config in entry["training"].items()),
        "",
        "## Files",
        "",
        "| file | content | bytes | SHA256 |",
        "|---|---|---|---|",
        *(
            f"| `{name}` | {_TITLES.get(name, '')} | {file['bytes']} | `{file['sha256']}` |"
            for name, file in entry["files"].items()
        ),
    ]
    return "\n".join(lines) + "\n"


def _scores(rows: Any) -> list[str]:
    """Return a table of the scores per data set, and one of the F1 per class for each scheme of classes."""
    lines = ["| data | points | overall accuracy | mean F1 | command |", "|---|---|---|---|---|"]
    for row in rows:
        scores = f"{row['overall_accuracy']:.3f} | {row['mean_f1']:.3f}"
        lines.append(f"| {row['data']} | {row['points']} | {scores} | `{row['command']}` |")
    for classes in dict.fromkeys(tuple(row["f1"]) for row in rows):
        same = [row for row in rows if tuple(row["f1"]) == classes]
        lines += ["", "| F1 | " + " | ".join(classes) + " |", "|---" * (len(classes) + 1) + "|"]
        lines += [
            f"| {row['data']} | " + " | ".join("–" if v is None else f"{v:.2f}" for v in row["f1"].values()) + " |"
            for row in same
        ]
    return lines


def _recorded(recordings: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the recordings of the training with their licences."""
    named = [f"{r['scenes']} scenes of {r['title']} ({r['licence']})" for r in recordings.values()]
    return " and ".join(named) or "no recording"


def _street(name: str, config: Mapping[str, Any]) -> str:
    shown = ("preset", "seed", "length")
    rest = {key: value for key, value in config.items() if key not in shown}
    cells = [name, *(str(config.get(key, "")) for key in shown), _plain(rest)]
    return "| " + " | ".join(cells) + " |"


def _plain(values: Mapping[str, Any]) -> str:
    """Return nested parameters in one line; a scanner of its own is given by its name."""
    parts = []
    for key, value in values.items():
        plain = list(value) if isinstance(value, tuple) else value  # as JSON gives it back
        named = value.get("name") if isinstance(value, Mapping) else None
        parts.append(f"{key} {named or (_plain(value) if isinstance(value, Mapping) else plain)}")
    return ", ".join(parts)
