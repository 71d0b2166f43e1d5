"""Files of model bundles: arrays as NPZ, the rest as JSON. Nothing is pickled."""

import functools
import json
import struct
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import DataError, MlsRoadError, ReadError
from mlsroad_pipeline.algorithms.core.plain_text import printable, shortened
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.models.array_checks import check_model_arrays
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle, bundle_scheme
from mlsroad_pipeline.execution.result_files import map_arrays
from mlsroad_pipeline.execution.store_files import sync_file, sync_folder
from mlsroad_pipeline.execution.task import SourceFile
from mlsroad_pipeline.formats.files import named_errors

FORMAT = 1
"""Version of the files' layout."""

_JSON, _ARRAYS = "model.json", "arrays.npz"


def save_bundle(bundle: ModelBundle, folder: str | Path) -> None:
    """Write a model into a folder; the same model gives the same bytes."""
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {name: np.asarray(bundle.arrays[name]) for name in sorted(bundle.arrays)}
    fresh = target / f".new.{_ARRAYS}"
    np.savez(fresh, **arrays)
    sync_file(fresh)
    fresh.replace(target / _ARRAYS)  # the arrays may be mapped from the file that this replaces
    content = {
        "format": FORMAT,
        "slug": bundle.slug,
        "arrays": sorted(bundle.arrays),
        "metadata": dict(bundle.metadata),
    }
    (target / _JSON).write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    sync_file(target / _JSON)
    sync_folder(target)


def load_bundle(folder: str | Path) -> ModelBundle:
    """Read a model from a folder."""
    source = Path(folder)
    with named_errors(source, "a model"):
        return _load_bundle(source)


def _load_bundle(source: Path) -> ModelBundle:
    for name in (_JSON, _ARRAYS):
        if (source / name).exists() and not (source / name).is_file():
            raise ReadError(f"{source / name} is not a file: the model is damaged, copy it again")
    try:
        content = json.loads((source / _JSON).read_text(encoding="utf-8"))
        arrays = map_arrays(source / _ARRAYS)
    except FileNotFoundError as error:
        raise ReadError(f"{source} is not a model: {Path(error.filename).name} is missing") from error
    except (ValueError, OSError, EOFError, KeyError, struct.error, zipfile.BadZipFile, zlib.error) as error:
        raise ReadError(f"{source}: the model's files are damaged: {error}") from error
    if not isinstance(content, dict) or not isinstance(content.get("metadata"), dict):
        raise ReadError(f"{source / _JSON}: the model's files are damaged: no metadata")
    if content.get("format") != FORMAT:
        raise ReadError(f"{source}: model format {content.get('format')!r}, this version reads {FORMAT}")
    if sorted(arrays) != content["arrays"]:
        raise ReadError(f"{source}: arrays {sorted(arrays)} where {content['arrays']} were written")
    try:
        check_model_arrays(arrays)
        _check_mappings(content["metadata"], "metadata")
        bundle = ModelBundle(content["slug"], arrays, content["metadata"])
        if "scheme" in bundle.metadata:
            bundle_scheme(bundle)
        _check_ground(bundle.metadata)
        return bundle
    except MlsRoadError as error:
        raise ReadError(f"{source / _JSON}: {error}") from error


def _check_ground(metadata: Mapping[str, Any]) -> None:
    """Raise DataError for parameters of the ground filter that it does not take, before anything is labelled."""
    given = metadata.get("parameters", {}).get("ground")
    try:
        if given is not None:
            _check_mapping(given, "metadata.parameters.ground")
            GroundParameters(**given)
    except (TypeError, ValueError) as error:
        raise DataError(
            f"metadata.parameters.ground: {printable(error)}: the model is damaged, copy it again"
        ) from error


def _check_mappings(metadata: Mapping[str, Any], name: str) -> None:
    """Raise DataError if parameters, segmentation or members of a model, or a part of them, are no mappings."""
    places = ("parameters", "parameters.recogniser", "parameters.recogniser.training", "segmentation", "members")
    for place in places:
        value: Any = metadata
        for key in place.split("."):
            value = value.get(key, {})
        _check_mapping(value, f"{name}.{place}")
    for slug, stored in metadata.get("members", {}).items():
        _check_mapping(stored, f"{name}.members.{slug}")
        _check_mappings(stored, f"{name}.members.{slug}")


def _check_mapping(value: Any, name: str) -> None:
    if not isinstance(value, dict):
        text = shortened(printable(json.dumps(value)))
        raise DataError(f"{name} is {text}, not a mapping: the model is damaged, copy or train it again")


@dataclass(frozen=True)
class ModelFile(SourceFile):
    """Handle of a stored model; a task's function gets the opened model."""

    def load(self) -> ModelBundle:
        """Read the model, once per process as long as the files stay as they are; raises ReadError as `load_bundle`."""
        marker = Path(self.path) / _JSON
        return _open(self.path, marker.stat().st_mtime_ns if marker.exists() else 0)


@functools.lru_cache(maxsize=2)
def _open(path: str, modified: int) -> ModelBundle:
    return load_bundle(path)
