"""The notebooks run from the first cell to the last on the results of a tiny run, and are stored without outputs."""

import base64
import io
import os
from pathlib import Path

import nbformat
import numpy as np
import pytest
from helpers.wiring import REPOSITORY, copied_run, shared_run
from jupyter_client.manager import KernelManager
from nbclient import NotebookClient
from PIL import Image

NOTEBOOKS = sorted((REPOSITORY / "notebooks").glob("*.ipynb"))
SAYS = {
    "fusion": ("of the pixels are right", "overall accuracy", "share of points seen"),
    "gallery": ("single_arm_lamp", "utility_pole", "length"),
    "label": ("objects", "median confidence", "mapped within 1.5 m"),
    "jointnet": ("HSSI", "(1, 5, 16, 16)", "correlation"),
    "patch_graph": ("matches of the same class", "smoothness"),
    "visual_words": ("points", "reference", "threshold", "detected"),
    "tour": ("train/survey.laz", "man-made terrain", "paved ground"),
}
"""Words expected in the outputs of each notebook."""
SMALLER = {
    "fusion": {
        "n_steps=100, crop=193, batch_size=4": "n_steps=5, crop=97, batch_size=2",
        "in (2, 3, 4)": "in (2,)",
        "60.0": "40.0",
        "n_trees=30": "n_trees=5",
    },
    "gallery": {'PRESETS["small"]': 'PRESETS["tiny"]', "(1, 2, 3, 4, 5)": "(1, 2)"},
    "label": {'"small", "--length", 40': '"tiny", "--length", 15'},
}
"""Code of notebooks and what is run in its place."""
FRESH = """import os
os.chdir({project!r})
os.environ.pop("MLFLOW_TRACKING_URI", None)
%reset -f
"""
"""First cell: the kernel as a new one, in the folder of the project."""
NEEDS_NO_RUN = {"fusion", "gallery", "jointnet", "label"}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_stored_without_outputs(path):
    cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    assert cells and not any(cell.outputs or cell.execution_count for cell in cells)


@pytest.fixture(scope="module")
def kernel():
    """One process for all notebooks: they import the same libraries, which takes as long as most of their cells."""
    manager = KernelManager(kernel_name="python3")
    manager.start_kernel(
        env={**os.environ, "PYTHONPATH": f"{REPOSITORY / 'src'}:{REPOSITORY / 'notebooks'}", "PYTHONWARNINGS": "ignore"}
    )
    yield manager
    manager.shutdown_kernel(now=True)


def smaller(source, changes):
    """Return the code of a cell with smaller numbers."""
    for name, value in changes.items():
        source = source.replace(name, value)
    return source


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs_and_its_pictures_show_something(path, kernel, tmp_path_factory, tmp_path):
    project = tmp_path / "project"
    if path.stem in NEEDS_NO_RUN:
        project.mkdir()
    else:
        copied_run(shared_run(tmp_path_factory), project)
    notebook, changes = nbformat.read(path, as_version=4), SMALLER.get(path.stem, {})
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(any(name in cell.source for cell in code) for name in changes)
    for cell in code:
        cell.source = smaller(cell.source, changes)
    start = nbformat.v4.new_code_cell(FRESH.format(project=str(project)))
    notebook.cells.insert(0, start)
    client = NotebookClient(notebook, km=kernel, timeout=300)
    client.execute()
    client.kc.stop_channels()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert not [output for output in outputs if output.output_type == "error"]
    pictures = [output.data["image/png"] for output in outputs if "image/png" in output.get("data", {})]
    assert len(pictures) >= 5
    for number, picture in enumerate(pictures):
        content = base64.b64decode(picture)
        if "MLSROAD_PICTURES" in os.environ:
            Path(os.environ["MLSROAD_PICTURES"], f"{path.stem}_{number}.png").write_bytes(content)
        pixels = np.asarray(Image.open(io.BytesIO(content)).convert("L"))
        assert min(pixels.shape) > 100 and pixels.std() > 5
    text = "".join(str(output.get("data", {}).get("text/plain", "")) for output in outputs)
    assert [words for words in SAYS[path.stem] if words not in text] == []
