"""Finished output of `label`: its record, its labelled files and the settings that label it again."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.datasets.inventory.exports import EXPORTS
from mlsroad_pipeline.execution.run_folder import FINISHED
from mlsroad_pipeline.execution.run_identity import STATE


@dataclass(frozen=True)
class LabelledOutput:
    """Output folder of a finished run of `label`.

    Parameters
    ----------
    path : Path
        The folder.
    record : mapping
        Record of its last finished run.
    """

    path: Path
    record: Mapping[str, Any]

    @classmethod
    def at(cls, folder: str | Path) -> LabelledOutput:
        """Return the output in a folder; ReadError if no run is finished there, or its record is damaged."""
        place = Path(folder)
        paths = sorted(place.glob(f"{STATE}/*/run.json"), key=lambda path: path.stat().st_mtime_ns)
        found = []
        for path in paths:
            try:
                record = json.loads(path.read_text(encoding="utf-8"))
                if record["state"] == FINISHED and record["summary"] and record["settings"]["label"]:
                    found.append(record)
            except (OSError, ValueError, KeyError, TypeError) as error:
                raise ReadError(f"{path} is damaged: label the survey again (--overwrite)") from error
        if not found:
            raise ReadError(f"{place} holds no finished results of label: label the survey first (mlsroad label FILE)")
        return cls(place, found[-1])

    @property
    def model(self) -> Mapping[str, Any]:
        """Name, version and source of the model that labelled."""
        model = self.record["summary"]["model"]
        return model if isinstance(model, Mapping) else {"name": str(model), "version": ""}

    @property
    def method(self) -> str:
        """Slug of its method."""
        return str(self.record["summary"]["method"])

    @property
    def schemes(self) -> Mapping[str, Any]:
        """Class schemes of the configuration."""
        found: Mapping[str, Any] = self.record["settings"]["classes"]["schemes"]
        return found

    def _names(self) -> list[str]:
        return [str(entry["path"]) for entry in self.record["outputs"]]

    def clouds(self) -> dict[str, Path]:
        """Return the labelled LAZ files by their path below the folder; ReadError if one is missing."""
        names = [name for name in self._names() if name.lower().endswith(".laz") and ".copc." not in name.lower()]
        missing = [name for name in names if not (self.path / name).is_file()]
        if missing or not names:
            raise ReadError(f"{self.path / (missing or ['*.laz'])[0]} is missing: label the survey again")
        return {name: self.path / name for name in sorted(names)}

    def parameters(self) -> dict[str, Any]:
        """Return the parameters of `label` that gave this output, without the model."""
        known = {name: value for name, value in self.record["settings"]["label"].items() if value not in (None, {}, [])}
        known = {name: value for name, value in known.items() if name not in ("model", "method")}
        names = self._names()
        exports = [
            name
            for name, export in EXPORTS.items()
            if any(f"inventory/{file}" in names or file in names for file in export.files)
        ]
        extra: dict[str, Any] = {"export": exports} if exports else {}
        extra |= {"copc": True} if any(name.endswith(".copc.laz") for name in names) else {}
        extra |= {"photos": True} if (self.path / "photos").is_dir() else {}
        return {**known, **extra, "output": str(self.path), "overwrite": True}
