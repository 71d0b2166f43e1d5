"""Finished output of `label`: its record, its labelled files and the settings that label it again."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ReadError
from mlsroad_pipeline.execution.run_folder import FileState, RunFolder, state_of
from mlsroad_pipeline.execution.run_identity import FINISHED, STATE, finished_record
from mlsroad_pipeline.formats.base import NEW_SURVEY, ReadOptions
from mlsroad_pipeline.formats.ply.coloured_ply import COLOURED
from mlsroad_pipeline.inventory_files.exports import EXPORTS

_OF_POINTS = ("units", "height_units", "crs", "reproject")
_OF_LAS = ("intensity_scale", "intensity_range", "columns", "rgb_bits")
"""Options of the readers that hold for the labelled LAZ too: always, and where the survey was LAS or LAZ."""


@dataclass(frozen=True)
class LabelledOutput:
    """Output folder of a finished run of `label`."""

    path: Path  # The folder
    record: Mapping[str, Any]  # Record of its last finished run

    @classmethod
    def at(cls, folder: str | Path) -> LabelledOutput:
        """Return the output in a folder; ReadError if no run is finished there, or its record is damaged."""
        place = Path(folder)
        record = finished_record(place)
        settings = None if record is None else record.get("settings")
        if record is None or not isinstance(settings, Mapping) or not settings.get("label"):
            raise ReadError(f"{place} holds no finished results of label: label the survey first (mlsroad label FILE)")
        return cls(place, record)

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
        found: Mapping[str, Any] = (self.record["settings"].get("classes") or {}).get("schemes", {})
        return found

    def model_scheme(self, codes: Collection[int]) -> ClassScheme | None:
        """Return the configured scheme of the model, None if it is none of them; `codes` are those with a name."""
        counted = set(self.record["summary"].get("classes", ())) - {"unlabelled"}
        schemes = [ClassScheme.from_config(name, spec) for name, spec in self.schemes.items()]
        is_standard = self.written_scheme is None
        fitting = [
            scheme
            for scheme in schemes
            if counted and counted <= set(scheme.classes) and (not is_standard or set(scheme.asprs) <= set(codes))
        ]
        return max(fitting, key=len) if fitting else None

    @property
    def written_scheme(self) -> ClassScheme | None:
        """Scheme whose classes are written as codes from 64; None where LAS codes are written."""
        name = self.record["settings"].get("label", {}).get("scheme", "asprs")
        return (
            None if name == "asprs" or name not in self.schemes else ClassScheme.from_config(name, self.schemes[name])
        )

    def _names(self) -> list[str]:
        return [str(entry["path"]) for entry in self.record["outputs"]]

    def clouds(self) -> dict[str, Path]:
        """Return the labelled LAZ files by their path below the folder; ReadError if one is missing."""
        names = [name for name in self._names() if name.lower().endswith(".laz") and ".copc." not in name.lower()]
        missing = [name for name in names if not (self.path / name).is_file()]
        if missing or not names:
            raise ReadError(f"{self.path / (missing or ['*.laz'])[0]} is missing: label the survey again")
        return {name: self.path / name for name in sorted(names)}

    def check_unedited(self, names: Collection[str] | None = None) -> None:
        """Raise DataError if a result is not as its run wrote it; `names` are paths below the folder, None for all."""
        for entry in self.record["outputs"]:
            path = self.path / entry["path"]
            now = state_of(path) if names is None or entry["path"] in names else None
            if now is None or now == FileState(entry["bytes"], entry["blake2b"]):
                continue
            if any(now in run.versions().get(entry["path"], ()) for run in self._other_runs()):
                raise DataError(f"{path} is of a run of label that was not finished: label the survey again")
            raise DataError(
                f"{path} was edited since it was written: copy it, label the survey again (--overwrite), "
                f"and run mlsroad corrections import COPY {self.path}"
            )

    def _other_runs(self) -> list[RunFolder]:
        runs = [RunFolder(str(path.parent)) for path in self.path.glob(f"{STATE}/*/run.json")]
        return [run for run in runs if run.read().get("state") != FINISHED]

    def read_options(self) -> ReadOptions:
        """Return the options that read the labelled LAZ as `label` read the survey: in metres, whatever their unit."""
        label = self.record["settings"]["label"]
        given = dict(label.get("read") or {}) | ({"crs": label["crs"]} if label.get("crs") else {})
        sources = [str(entry["path"]).lower() for entry in self.record.get("inputs", ())]
        is_las = any(path.endswith((".las", ".laz")) for path in sources)
        names = (*_OF_POINTS, *_OF_LAS) if is_las else _OF_POINTS
        return ReadOptions.from_config({**NEW_SURVEY, **{name: given[name] for name in names if name in given}})

    def parameters(self) -> dict[str, Any]:
        """Return the parameters of `label` that gave this output, without the model."""
        known = {name: value for name, value in self.record["settings"]["label"].items() if value not in ({}, [])}
        known = {name: value for name, value in known.items() if name not in ("model", "method")}
        names = self._names()
        exports = [
            name
            for name, export in EXPORTS.items()
            if any(f"inventory/{file}" in names or file in names for file in export.files)
        ]
        extra: dict[str, Any] = {"export": exports} if exports else {}
        extra |= {"copc": True} if any(name.endswith(".copc.laz") for name in names) else {}
        extra |= {"coloured_ply": True} if any(name.endswith(COLOURED) for name in names) else {}
        extra |= {"photos": True} if (self.path / "photos").is_dir() else {}
        return {**known, **extra, "output": str(self.path), "overwrite": True}
