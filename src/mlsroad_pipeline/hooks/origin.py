"""Origin of tables of scores and of reports: commit, command, seeds, versions and data, without MLflow."""

import html
import json
import sys
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from kedro.framework.hooks import hook_impl
from kedro.io import CatalogProtocol
from kedro.pipeline import Pipeline

from mlsroad_pipeline.datasets.report_files import HtmlReportDataset, ScoresDataset
from mlsroad_pipeline.execution.digests import digest_json
from mlsroad_pipeline.hooks.run_details import (
    environment,
    fingerprint_files,
    git_state,
    pipeline_parameters,
    source_files,
    typed_command,
)

PACKAGES = ("mlsroad_pipeline", "kedro", "lightgbm", "numba", "numpy", "scikit-learn", "scipy", "torch")
"""Packages whose versions may change scores."""


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


class OriginHooks:
    """Write the origin of each table of scores as JSON beside it, and as the footer of each report of a comparison."""

    def __init__(self) -> None:
        self._origin: dict[str, Any] | None = None
        self._sources: set[str] = set()
        self._run: tuple[Mapping[str, Any], Pipeline, CatalogProtocol] | None = None

    @hook_impl
    def before_pipeline_run(self, run_params: dict[str, Any], pipeline: Pipeline, catalog: CatalogProtocol) -> None:
        """Take the run; its origin is determined with the first table or report, which `label` has none of."""
        self._origin, self._sources, self._run = None, set(), (run_params, pipeline, catalog)

    def _of_run(self) -> dict[str, Any]:
        """Return the origin; the digest of the data is that of the raw files that tasks of this run name."""
        if self._origin is None and self._run is not None:
            run_params, pipeline, catalog = self._run
            git = git_state(Path(run_params.get("project_path") or Path.cwd()))
            names = run_params.get("pipeline_names") or ["__default__"]
            flat = pipeline_parameters(pipeline, catalog)
            self._origin = {
                "commit": git.get("git.commit"),
                "dirty": git["git.dirty"] == "true" if git else None,
                "command": typed_command(f"kedro run --pipelines={','.join(names)}", run_params.get("env"), sys.argv),
                "seed": {n: v for n, v in flat.items() if n.rpartition(".")[2] in ("seed", "seeds")},
                "parameters": digest_json(flat),
                "versions": environment()[0] | {package: _version(package) for package in PACKAGES},
                "date": datetime.now(UTC).date().isoformat(),
            }
        data = fingerprint_files(sorted(self._sources))["digest"] if self._sources else None
        return {**(self._origin or {}), "data": data}

    @hook_impl
    def after_node_run(self, outputs: dict[str, Any], catalog: CatalogProtocol) -> None:
        """Add the footer to reports before they are saved."""
        for name, page in outputs.items():
            dataset = catalog.get(name)
            if isinstance(dataset, HtmlReportDataset) and not dataset.of_label and isinstance(page, str):
                footer = f"<footer>{html.escape(_sentence(self._of_run()))}</footer>"
                outputs[name] = page.replace("</main></body>", f"</main>\n{footer}</body>")

    @hook_impl
    def after_dataset_saved(self, dataset_name: str, data: Any) -> None:
        """Collect the raw files that tasks read, and write the origin of a table of scores."""
        self._sources.update(source_files(data))
        dataset = self._run[2].get(dataset_name) if self._run is not None else None
        if isinstance(dataset, ScoresDataset):
            dataset.save_origin(json.dumps(self._of_run(), indent=2, ensure_ascii=False) + "\n")


def _sentence(origin: Mapping[str, Any]) -> str:
    """Return the origin as the text of a footer."""
    changed = " with changes" if origin["dirty"] else ""
    parts = [
        origin["command"],
        f"commit {origin['commit']}{changed}" if origin["commit"] else "",
        f"data {origin['data']}" if origin["data"] else "",
        ", ".join(f"{name} = {value}" for name, value in origin["seed"].items()),
        ", ".join(f"{name} {number}" for name, number in origin["versions"].items()),
        origin["date"],
    ]
    return "; ".join(part for part in parts if part)
