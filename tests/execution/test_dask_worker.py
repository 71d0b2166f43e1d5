"""The executor of a Dask worker's main thread."""

import threading

import pytest

from mlsroad_pipeline.execution.dask_worker import MainThread


def test_calls_run_in_the_thread_that_runs_the_executor_until_its_shutdown():
    calls, here = MainThread(), threading.get_ident()
    thread, total = calls.submit(threading.get_ident), calls.submit(sum, [1, 2], start=3)
    failed, cancelled = calls.submit(int, "x"), calls.submit(int)
    cancelled.cancel()
    calls.shutdown()
    late = calls.submit(int)
    calls.run()
    assert thread.result(0) == here and total.result(0) == 6 and cancelled.cancelled() and not late.done()
    with pytest.raises(ValueError, match="invalid literal"):
        failed.result(0)
