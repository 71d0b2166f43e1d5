"""Identity of a run of `label`: the settings that change its result, and the folder that is named by their digest."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.algorithms.models.methods import needs_images
from mlsroad_pipeline.execution.digests import digest_file, digest_json

STATE = ".mlsroad"
"""Folder below an output that holds the state and the records of its runs; it marks a folder of results."""

GROUPS = ("ingest", "ground_removal", "classes")
"""Groups of parameters that `label` uses besides its own."""

SEGMENTATION = (
    "classes", "scheme", "reach", "visibility", "magnification", "window", "overlap", "flip", "mean", "spread",
    "device",
)  # fmt: skip
"""Parameters of `image_labels` that `label` uses together with masks or weights."""

UNRELATED = ("output", "overwrite", "keep_state", "copc", "coloured_ply", "export", "photos")
"""Parameters of `label` that change no label: a run with another value of them is the same run."""

RECORD, FINISHED = "run.json", "finished"
"""Record of a run in its folder, and its state once the run is finished."""

_DIGITS = 12


def absolute(path: object) -> str:
    """Return an absolute path with `~` expanded; symbolic links stay."""
    return os.path.abspath(os.path.expanduser(str(path)))


def run_settings(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of a run as plain data, from the configured parameters."""
    label = {name: value for name, value in parameters["label"].items() if name not in UNRELATED}
    survey = label.get("survey") or ()
    paths = [survey] if isinstance(survey, str | os.PathLike | int) else list(survey)
    label["survey"] = [absolute(path) for path in paths]
    settings = {"label": label, **{group: parameters.get(group) for group in GROUPS}}
    if label.get("method") is None or needs_images(str(label["method"])):
        settings |= _own_segmentation(parameters.get("image_labels") or {})
    plain: dict[str, Any] = json.loads(json.dumps(settings, default=str))
    return plain


def _own_segmentation(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings of images segmented by masks or weights, with digests of their files; else none."""
    masks, weights = given.get("masks"), given.get("weights")
    if masks is None and weights is None:
        return {}
    paths = {name: absolute(given[name]) for name in ("masks", "weights", "classes") if given.get(name) is not None}
    folder = {"masks": paths["masks"]} if masks is not None and os.path.isdir(paths["masks"]) else {}
    files = {name: paths[name] for name in ("weights", "classes") if name in paths and os.path.isfile(paths[name])}
    digests = {f"{name}_digest": digest_file(path) for name, path in files.items()}
    used = {name: given.get(name) for name in ("masks", "weights", *SEGMENTATION)}
    return {"image_labels": {**used, **folder, **files, **digests}}


def run_folder(parameters: Mapping[str, Any]) -> Path | None:
    """Return the folder of a run below its output, or None without an output."""
    output = parameters.get("label", {}).get("output")
    if not output:
        return None
    folder = absolute(output)
    if not folder.isprintable() or "{" in folder or "}" in folder:
        raise ParameterError(
            f"label.output: {folder!r} has a brace or a control character in its name: choose another folder (-o)"
        )
    return Path(folder, STATE, digest_json(run_settings(parameters))[:_DIGITS])


def first_difference(one: Any, other: Any, name: str = "") -> str | None:
    """Return the first setting that differs, with both values, or None.

    Examples
    --------
    >>> first_difference({"label": {"scheme": "asprs"}}, {"label": {"scheme": "tomic2019"}})
    "label.scheme is 'asprs' there and 'tomic2019' here"
    """
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        keys = dict.fromkeys((*one, *other))
        inner = (first_difference(one.get(key), other.get(key), f"{name}.{key}".lstrip(".")) for key in keys)
        return next((text for text in inner if text), None)
    return None if one == other else f"{name} is {_short(one)} there and {_short(other)} here"


def _short(value: Any) -> str:
    one = value[0] if isinstance(value, list) and len(value) == 1 else value
    text = "null" if one is None else repr(one)
    return text if len(text) <= 80 else f"{text[:77]}..."


def finished_record(output: Path) -> dict[str, Any] | None:
    """Return the record of the last finished run into an output folder, None if there is none."""
    for path in sorted(output.glob(f"{STATE}/*/{RECORD}"), key=lambda path: path.stat().st_mtime_ns, reverse=True):
        try:
            record = json.loads(path.read_text(encoding="utf-8"))
            if record["state"] == FINISHED and record["summary"]:
                return dict(record)
        except OSError as error:
            raise ReadError(f"{path} cannot be read: {error.strerror}") from error
        except (ValueError, KeyError, TypeError) as error:
            raise ReadError(f"{path} is damaged: label the survey again (--overwrite)") from error
    return None
