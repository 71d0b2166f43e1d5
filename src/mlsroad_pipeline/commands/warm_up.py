"""Command `mlsroad warm-up`: compile the kernels before the first survey."""

import tempfile
from pathlib import Path

from mlsroad_pipeline.commands.console import one_line_errors, output_console
from mlsroad_pipeline.commands.label import label_files
from mlsroad_pipeline.commands.options import Verbose
from mlsroad_pipeline.commands.session import compiled_kernels
from mlsroad_pipeline.commands.simulate import write_street


def warm_up(verbose: Verbose = False) -> None:
    """Compile the kernels of `label`, so that the first survey need not wait: by labelling a tiny street.

    Nothing is kept but the compiled kernels. In an image of a container, run it when the image is built.
    """
    with one_line_errors(verbose=verbose), tempfile.TemporaryDirectory(prefix="mlsroad-") as folder:
        street = Path(folder, "street")
        write_street({"preset": "tiny"}, street, overwrite=False)
        label_files(
            [str(street)], str(Path(folder, "labelled")), {"given": {}}, params=None, workers=None, verbose=verbose
        )
        output_console().print(f"\n{compiled_kernels()} kernels are compiled.")
