"""Files of a model bundle: arrays as NPZ, the rest as JSON. Nothing is pickled."""

from __future__ import annotations

import json
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.execution.mapped_arrays import map_arrays

FORMAT = 1
"""Version of the files' layout."""

_JSON, _ARRAYS = "model.json", "arrays.npz"


def save_bundle(bundle: ModelBundle, folder: str | Path) -> None:
    """Write a model into a folder; the same model gives the same bytes.

    Parameters
    ----------
    bundle : ModelBundle
        The model.
    folder : str or Path
        Where to; made if it is not there. Holds ``arrays.npz`` and ``model.json`` afterwards.
    """
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, Any] = {name: np.asarray(bundle.arrays[name]) for name in sorted(bundle.arrays)}
    np.savez(target / _ARRAYS, **arrays)
    content = {
        "format": FORMAT,
        "slug": bundle.slug,
        "arrays": sorted(bundle.arrays),
        "metadata": dict(bundle.metadata),
    }
    (target / _JSON).write_text(json.dumps(content, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def load_bundle(folder: str | Path, *, check: bool = True) -> ModelBundle:
    """Read a model from a folder.

    Parameters
    ----------
    folder : str or Path
        A folder that `save_bundle` wrote.
    check : bool, default True
        Whether to read everything once and compare it with its checksums.

    Returns
    -------
    ModelBundle
        The model. Its arrays are mapped into memory: what is not used is not read, and processes that use one model
        share it.

    Raises
    ------
    ReadError
        If a file is missing, damaged, of a later format, or the arrays are not those that were written.
    """
    source = Path(folder)
    try:
        content = json.loads((source / _JSON).read_text(encoding="utf-8"))
        if check:
            _check_sums(source / _ARRAYS)
        arrays = map_arrays(source / _ARRAYS)
    except FileNotFoundError as error:
        raise ReadError(f"{source} is no model: {Path(error.filename).name} is missing") from error
    except (ValueError, OSError, EOFError, KeyError, struct.error, zipfile.BadZipFile, zlib.error) as error:
        raise ReadError(f"{source}: the model's files are damaged: {error}") from error
    if content.get("format") != FORMAT:
        raise ReadError(f"{source}: model format {content.get('format')!r}, this version reads {FORMAT}")
    if sorted(arrays) != content["arrays"]:
        raise ReadError(f"{source}: arrays {sorted(arrays)} where {content['arrays']} were written")
    return ModelBundle(content["slug"], arrays, content["metadata"])


def _check_sums(path: Path) -> None:
    with zipfile.ZipFile(path) as archive:
        damaged = archive.testzip()
    if damaged is not None:
        raise ValueError(f"{damaged} differs from its checksum")
