"""Trained models in the package: plain files, a registry with one entry per model, and cards."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.model_store.bundle_files import load_bundle, save_bundle

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


FOLDER = Path(__file__).with_name("shipped")
"""Folder of the models in the package."""

REGISTRY, CARD = "registry.json", "card.md"
_LISTED = 12
"""Most training streets whose seeds are listed in one line."""


@dataclass(frozen=True)
class ModelScores:
    """Scores of a model on one data set."""

    data: str  # The data set
    points: int  # Number of scored points
    # overall_accuracy, mean_f1: scores
    overall_accuracy: float
    mean_f1: float
    f1: Mapping[str, float | None]  # F1 of each class; None for classes without points
    command: str  # Command that prints the scores


@dataclass(frozen=True)
class ShippedModel:
    """Registry entry of a model in the package."""

    name: str  # Name of the model and of its folder
    method: str  # Slug of the method
    summary: str  # Surveys that the model is for
    version: str  # Version of the package that trained the model
    licence: str  # Licence of the model
    command: str  # Command that trains the model
    files: Mapping[str, Mapping[str, Any]]  # Name of each file to ``bytes`` and ``sha256``
    classes: tuple[str, ...]  # Class names in label order
    attributes: tuple[str, ...]  # Columns that the model uses where a survey has them
    training: Mapping[str, Mapping[str, Any]]  # Name of each training survey to its parameters of the simulator
    samples: int  # Number of training voxels
    scores: tuple[ModelScores, ...] = field(default_factory=tuple)  # Scores on data that the model was not trained on
    # Recordings that the model was trained on: ``title``, ``licence``, ``scenes`` and ``sha256`` of each
    recordings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    # Ranges of the facts of the training scenes, see `algorithms.quality.training_facts`
    training_facts: Mapping[str, Sequence[float]] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Return the size of the files in bytes."""
        return sum(int(file["bytes"]) for file in self.files.values())

    @property
    def trained_on(self) -> str:
        """Return the training data in one line."""
        seeds = ", ".join(str(survey.get("seed", 0)) for survey in self.training.values())
        listed = f" (seeds {seeds})" if len(self.training) <= _LISTED else ""
        recorded = "".join(f" and {recording['title']}" for recording in self.recordings.values())
        return f"{len(self.training)} simulated streets{listed}{recorded}"


def shipped_models(folder: Path = FOLDER) -> dict[str, ShippedModel]:
    """Return the registry entries of the models in the package by name."""
    path = folder / REGISTRY
    if not path.is_file():
        return {}
    entries = json.loads(path.read_text(encoding="utf-8"))["models"]
    return {name: _entry(name, values) for name, values in entries.items()}


def _entry(name: str, values: Mapping[str, Any]) -> ShippedModel:
    plain: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}
    plain["scores"] = tuple(ModelScores(**row) for row in values["scores"])
    return ShippedModel(name, **plain)


def load_shipped(name: str, folder: Path = FOLDER) -> ModelBundle:
    """Read a model of the package."""
    models = shipped_models(folder)
    if name not in models:
        raise ParameterError(f"no model of the package is named {name!r} (models: {', '.join(models)})")
    for file, facts in models[name].files.items():
        path = folder / name / file
        if not path.is_file():
            raise ReadError(f"{path} is missing: install mlsroad_pipeline again")
        if _sha256(path) != facts["sha256"]:
            raise ReadError(f"{path} is damaged (wrong SHA256): install mlsroad_pipeline again")
    bundle = load_bundle(folder / name)
    shipped = {"name": name, "version": models[name].version}
    return replace(bundle, metadata={**bundle.metadata, "shipped": shipped})


def shipped_again(name: str) -> tuple[ModelBundle, ShippedModel]:
    """Return a model of the package as `save_shipped` takes it, and its entry."""
    bundle = load_shipped(name)
    return replace(bundle, metadata={k: v for k, v in bundle.metadata.items() if k != "shipped"}), shipped_models()[
        name
    ]


def save_shipped(bundle: ModelBundle, model: ShippedModel, folder: Path = FOLDER) -> ShippedModel:
    """Write the files of a model, its registry entry and its card."""
    target = folder / model.name
    save_bundle(bundle, target)
    files = {
        path.name: {"bytes": path.stat().st_size, "sha256": _sha256(path)}
        for path in sorted(target.iterdir())
        if path.name != CARD
    }
    written = replace(model, files=files)
    save_entry(written, folder)
    return written


def save_entry(model: ShippedModel, folder: Path = FOLDER) -> None:
    """Write the registry entry of a model and its card."""
    models = {**shipped_models(folder), model.name: model}
    entries = {name: {k: v for k, v in asdict(models[name]).items() if k != "name"} for name in sorted(models)}
    text = json.dumps({"models": entries}, indent=2, ensure_ascii=False)
    (folder / REGISTRY).write_text(text + "\n", encoding="utf-8")
    (folder / model.name / CARD).write_text(model_card(asdict(model)), encoding="utf-8")


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
