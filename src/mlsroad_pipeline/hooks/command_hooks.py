"""What a command that started workers before anything else does when its pipeline begins and ends."""

from __future__ import annotations

import threading

from kedro.framework.hooks import hook_impl

from mlsroad_pipeline.hooks.early_workers import end_start, end_workers


class EarlyWorkersHooks:
    """End the start when the pipeline begins, and the workers when it has ended.

    Parameters
    ----------
    thread : Thread or None
        What `start_early` gave; with None nothing is done.
    """

    def __init__(self, thread: threading.Thread | None) -> None:
        self._thread = thread

    @hook_impl(trylast=True)
    def before_pipeline_run(self) -> None:
        """End the start."""
        if self._thread is not None:
            end_start()

    @hook_impl(trylast=True)
    def after_pipeline_run(self) -> None:
        """End the workers."""
        self._end()

    @hook_impl(trylast=True)
    def on_pipeline_error(self) -> None:
        """End the workers."""
        self._end()

    def _end(self) -> None:
        if self._thread is not None:
            end_workers(self._thread)
