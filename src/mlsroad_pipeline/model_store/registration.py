"""Registration of models in an MLflow registry with descriptions and aliases, and their loading."""

import json
import logging
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import mlflow
import pandas as pd
from kedro.io import DatasetError
from mlflow.exceptions import MlflowException
from mlflow.models.model import ModelInfo

from mlsroad_pipeline import __version__
from mlsroad_pipeline.algorithms.core.plain_text import printable, without_password
from mlsroad_pipeline.algorithms.models.bundle import ModelBundle
from mlsroad_pipeline.algorithms.models.methods import METHODS, trained_methods
from mlsroad_pipeline.execution.digests import digest_file
from mlsroad_pipeline.execution.scratch import scratch_folder
from mlsroad_pipeline.model_store.bundle_files import load_bundle, save_bundle
from mlsroad_pipeline.model_store.point_labeller import signature

CHALLENGER = "challenger"
"""Alias of the newest version of a registered model. (MLflow reserves the alias ``latest``.)"""

_SCORES = "\n\nScores: "
_PAGES_OF_SEVERAL = {
    "patch_baselines": ("patch_svm", "patch_forest", "shape_based", "max_margin_markov"),
    "detection_baselines": ("hough_forest", "object_matching", "bottom_up_top_down"),
    "recognition_baselines": ("descriptors", "pointnet"),
}
"""Page of the manual to the folders of its methods; the page of any other method has the name of its folder."""


def annotate_version(name: str, number: int, slug: str, metadata: Mapping[str, Any]) -> None:
    """Set the alias and the descriptions of a new version; the alias `champion` is the user's."""
    client = mlflow.MlflowClient()
    client.set_registered_model_alias(name, CHALLENGER, str(number))
    client.update_model_version(name, str(number), model_description(metadata))
    if slug in trained_methods():
        client.update_registered_model(name, f"Method `{slug}` ({METHODS[slug].task}): {manual_page(slug)}")


def manual_page(slug: str) -> str:
    """Return the path of the page of the manual on a method."""
    folder = METHODS[slug].folder.rsplit(".", 1)[-1]
    page = next((page for page, folders in _PAGES_OF_SEVERAL.items() if folder in folders), folder)
    return f"docs/methods/{page}.md"


def model_description(metadata: Mapping[str, Any]) -> str:
    """Return the text of a version: training data, classes and seed."""
    trained_on = metadata.get("trained_on", "unknown data")
    if isinstance(trained_on, Mapping):
        trained_on = ", ".join(
            f"{key} {f'{len(value)} of them' if isinstance(value, list | tuple) else value}"
            for key, value in trained_on.items()
        )
    lines = [f"Trained on {trained_on}.", f"Classes: {', '.join(map(str, metadata.get('classes', ())))}."]
    seeds = sorted({str(seed) for seed in _seeds(metadata.get("parameters"))})
    if seeds:
        lines.append(f"Seed: {', '.join(seeds)}.")
    return "\n\n".join(lines)


def describe_version(name: str, number: str, scores: pd.DataFrame) -> None:
    """Add scores over all classes, one row per method and split, to the description of a version."""
    client = mlflow.MlflowClient()
    before = (client.get_model_version(name, number).description or "").split(_SCORES)[0]
    rows = []
    for split, values in zip(scores.index.get_level_values("split"), scores.to_dict("records"), strict=True):
        defined = {str(metric).replace("_", " "): value for metric, value in values.items() if pd.notna(value)}
        rows.append(f"{split}: " + ", ".join(f"{metric} {value:.3f}" for metric, value in defined.items()))
    client.update_model_version(name, number, f"{before}{_SCORES}{'; '.join(rows)}.")


def _seeds(parameters: Any) -> Iterator[Any]:
    if isinstance(parameters, Mapping):
        for name, value in parameters.items():
            if name == "seed":
                yield value
            else:
                yield from _seeds(value)


LOGGER = logging.getLogger(__name__)

REQUIREMENTS = ("mlflow", "numba", "numpy", "pandas", "scipy", "scikit-learn")
"""Distributions that a registered model pins, beside this package."""

FINGERPRINT = "fingerprint"
"""Tag of a version: digest of the model's files."""

_CODE = Path(__file__).with_name("registered_model_code.py")


def example_points() -> pd.DataFrame:
    """Return an example input of a registered model: a flat patch with a post."""
    flat = [(x / 5, y / 5, 0.0) for x in range(4) for y in range(4)]
    post = [(0.3, 0.3, z / 5) for z in range(1, 11)]
    table = pd.DataFrame(flat + post, columns=["x", "y", "z"])
    return table.assign(red=120, green=118, blue=112, intensity=0.4)


def pip_requirements() -> list[str]:
    """Return the requirements of a registered model, pinned to the installed versions."""
    pins = [f"mlsroad_pipeline=={__version__}"]
    for name in REQUIREMENTS:
        try:
            pins.append(f"{name}=={version(name)}")
        except PackageNotFoundError as error:
            raise DatasetError(f"{name} is not installed: a model cannot be registered without it") from error
    return pins


def latest_version(name: str) -> int:
    """Return the highest version of a registered model."""
    client = mlflow.MlflowClient()
    versions = [int(found.version) for found in client.search_model_versions(f"name='{name}'")]
    if not versions:
        store = without_password(mlflow.get_registry_uri())
        raise DatasetError(f"no model {name!r} is registered in {store}: run the comparison first")
    return max(versions)


def load_registered_bundle(name: str, *, model_version: int | str | None = None) -> ModelBundle:
    """Read a model from the registry."""
    number = latest_version(name) if model_version is None else int(model_version)
    try:
        found = mlflow.MlflowClient().get_model_version(name, str(number))
        folder = mlflow.artifacts.download_artifacts(f"models:/{name}/{number}")
    except MlflowException as error:
        raise DatasetError(
            f"model {name!r} version {number} cannot be read: {without_password(printable(error))}"
        ) from error
    files = Path(folder) / "artifacts" / "bundle"
    if found.tags.get(FINGERPRINT) not in (None, digest_file(str(files))):
        raise DatasetError(f"model {name!r} version {number}: {files} differs from the files that were registered")
    bundle = load_bundle(files)
    LOGGER.info("Model %s version %s, trained on %s", name, number, bundle.metadata.get("trained_on", "unknown data"))
    registered = {"name": name, "version": number, "run_id": found.run_id}
    return replace(bundle, metadata={**bundle.metadata, "registered": registered})


@contextmanager
def _run() -> Iterator[None]:
    """Use the active run or, without one, a new run that ends here."""
    if mlflow.active_run() is not None:
        yield
        return
    with mlflow.start_run(run_name="register model"):
        yield


def _registered_already(name: str, fingerprint: str) -> int | None:
    """Return the highest version if it is this model and its files exist."""
    client = mlflow.MlflowClient()
    highest = max(client.search_model_versions(f"name='{name}'"), key=lambda found: int(found.version), default=None)
    if highest is None or highest.tags.get(FINGERPRINT) != fingerprint:
        return None
    try:
        files = mlflow.artifacts.list_artifacts(f"models:/{name}/{highest.version}/artifacts/bundle")
    except (MlflowException, OSError):
        return None
    return int(highest.version) if files else None


def _new_version(name: str, info: ModelInfo) -> int:
    """Register a logged model; `mlflow.register_model` prints two lines at each call."""
    client = mlflow.MlflowClient()
    if not client.search_registered_models(f"name='{name}'"):
        client.create_registered_model(name)
    source = f"models:/{info.model_id}"
    return int(client.create_model_version(name, source, info.run_id, model_id=info.model_id).version)


def register_bundle(bundle: ModelBundle, name: str, *, input_example: pd.DataFrame | None = None) -> tuple[int, bool]:
    """Store a model and register it as a new version, unless the highest version is the same model.

    Two models are the same if `save_bundle` writes the same files for them. The tag ``fingerprint`` of a version holds
    their digest.
    """
    # JSON converts tuples to the lists that MLflow's YAML needs.
    plain = json.loads(json.dumps(dict(bundle.metadata)))
    metadata = {key: value for key, value in plain.items() if key != "registered"}
    with tempfile.TemporaryDirectory(dir=scratch_folder()) as folder, _run():
        save_bundle(replace(bundle, metadata=metadata), Path(folder) / "bundle")
        fingerprint = digest_file(str(Path(folder) / "bundle"))
        existing = _registered_already(name, fingerprint)
        if existing is not None:
            return existing, False
        info = mlflow.pyfunc.log_model(
            name=name,
            python_model=str(_CODE),
            artifacts={"bundle": str(Path(folder) / "bundle")},
            signature=signature(),
            input_example=example_points() if input_example is None else input_example,
            pip_requirements=pip_requirements(),
            metadata={"slug": bundle.slug, "package": f"mlsroad_pipeline {__version__}", **metadata},
        )
    number = _new_version(name, info)
    client = mlflow.MlflowClient()
    client.set_model_version_tag(name, str(number), FINGERPRINT, fingerprint)
    client.set_model_version_tag(name, str(number), "slug", bundle.slug)
    client.set_model_version_tag(name, str(number), "trained_on", str(metadata.get("trained_on", "")))
    annotate_version(name, number, bundle.slug, metadata)
    return number, True
