"""Records of runs of `label`: a finished run is not repeated, a run that ends is recorded, and its lock is released."""

import gc
import logging
from typing import Any

from kedro.framework.context import KedroContext
from kedro.framework.hooks import hook_impl
from kedro.framework.project import pipelines
from kedro.io import CatalogProtocol
from kedro.pipeline import Pipeline

from mlsroad_pipeline.execution.backends import end_processes
from mlsroad_pipeline.execution.output_lock import release_output
from mlsroad_pipeline.execution.run_folder import RunFolder
from mlsroad_pipeline.execution.run_identity import run_folder, run_settings
from mlsroad_pipeline.hooks.run_details import source_files
from mlsroad_pipeline.pipelines.composition import create_pipeline

logger = logging.getLogger(__name__)

LABEL, OPENED = "label", "plan_label_files"
"""Names of the pipeline, and of the node that opens the run."""
RUN, INVENTORY, SUMMARY = "label_run", "label_inventory", "label_summary"
"""Names of datasets of the pipeline."""


class LabelRunHooks:
    """Replace `label` by a report of its summary where its results are finished; close the record of a run."""

    def __init__(self) -> None:
        self._replaced = False
        self._sources: set[str] = set()

    @hook_impl(trylast=True)
    def after_context_created(self, context: KedroContext) -> None:
        """Replace the pipeline if its run is finished and unchanged; restore it for another run of this process."""
        if set(pipelines) != {LABEL}:  # another command: the registry has the requested pipelines alone
            return
        if self._replaced:
            pipelines[LABEL] = create_pipeline(LABEL)
        self._replaced = self._is_finished(context)
        if self._replaced:
            from mlsroad_pipeline.pipelines.label.repeat import repeat_pipeline  # noqa: PLC0415  # `label` alone needs it

            pipelines[LABEL] = repeat_pipeline()

    def _is_finished(self, context: KedroContext) -> bool:
        configured = context.config_loader["parameters"]
        folder = run_folder(configured)
        if folder is None or configured[LABEL].get("overwrite") or not folder.is_dir():
            return False
        from mlsroad_pipeline.pipelines.label.repeat import is_finished  # noqa: PLC0415  # `label` alone needs it

        parameters = context.params
        given = (parameters[name] for name in (LABEL, "ingest", "image_labels"))
        return is_finished(str(folder), run_settings(configured), *given)

    @hook_impl
    def before_pipeline_run(self) -> None:
        """Clear the list of files of an earlier run, and switch on garbage collection after an early start."""
        self._sources = set()
        if not gc.isenabled():
            gc.freeze()
            gc.enable()

    @hook_impl
    def after_dataset_saved(self, data: Any) -> None:
        """Collect the raw files that tasks read."""
        self._sources.update(source_files(data))

    @hook_impl(tryfirst=True)  # before MLflow, whose store may fail
    def after_pipeline_run(self, pipeline: Pipeline, catalog: CatalogProtocol) -> None:
        """Close the record of a run that wrote all results, and release the output."""
        if RUN not in pipeline.inputs():
            return
        run = catalog.load(RUN)
        if INVENTORY in pipeline.all_outputs():  # a part of the pipeline may end before the file is written
            catalog[INVENTORY].finish()
        if {OPENED, "write_label_report"} <= {node.name for node in pipeline.nodes}:
            parameters = catalog.load("params:label")
            sources = self._sources | ({parameters.sections} if parameters.sections else set())
            _remove_stale(run)
            run.close(catalog.load(SUMMARY), sources, keep_state=parameters.keep_state)
        release_output(run.output)
        end_processes()

    @hook_impl(trylast=True)
    def on_pipeline_error(self, pipeline: Pipeline, catalog: CatalogProtocol) -> None:
        """Release the output."""
        if RUN in pipeline.inputs():
            release_output(catalog.load(RUN).output)
            end_processes()


def _remove_stale(run: RunFolder) -> None:
    """Remove what describes the results that a run with `label.overwrite` has replaced."""
    if not run.read().get("overwrite"):
        return
    from mlsroad_pipeline.label.runs import is_companion  # noqa: PLC0415  # `label` alone needs it

    stale = run.remove_stale(is_companion)
    if stale:
        logger.warning("Removed %d files of the replaced run: %s", len(stale), ", ".join(stale[:5]))
