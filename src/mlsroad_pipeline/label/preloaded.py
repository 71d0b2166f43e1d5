"""Module that the fork server imports: it loads the libraries and compiled kernels of `label`, in the server alone."""

from mlsroad_pipeline.execution.fork_server import load


def _run_stages() -> None:
    from mlsroad_pipeline.label.warm_up import run_stages  # noqa: PLC0415  # the server alone imports the libraries

    run_stages()


load(_run_stages)
