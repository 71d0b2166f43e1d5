"""The notebooks run from the first cell to the last on the results of a tiny run, and are stored without outputs."""

import base64
import io
import os
import re
import shutil
from pathlib import Path

import nbformat
import numpy as np
import pytest
from helpers.wiring import REPOSITORY, shared_run
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
NEEDS_NO_RUN = {"fusion", "gallery", "jointnet", "label"}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_stored_without_outputs(path):
    cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    assert cells and not any(cell.outputs or cell.execution_count for cell in cells)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_page_in_the_documentation_has_the_code_of_the_notebook_and_its_pictures(path):
    pages = REPOSITORY / "docs" / "notebooks"
    page = (pages / f"{path.stem}.md").read_text(encoding="utf-8")
    for cell in nbformat.read(path, as_version=4).cells:
        assert cell.source in page, "run benchmarks/notebook_pictures.py and benchmarks/notebook_pages.py"
    pictures = re.findall(r"\]\((\w+\.webp)\)", page)
    assert len(pictures) >= 5 and all((pages / name).is_file() for name in pictures)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs_and_its_pictures_show_something(path, tmp_path_factory, tmp_path, monkeypatch):
    project = tmp_path / "project"
    if path.stem in NEEDS_NO_RUN:
        project.mkdir()
    else:
        shutil.copytree(
            shared_run(tmp_path_factory), project, ignore=shutil.ignore_patterns("mlartifacts", "02_intermediate")
        )
    monkeypatch.setenv("PYTHONPATH", str(REPOSITORY / "src"))
    monkeypatch.setenv("PYTHONWARNINGS", "ignore")
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(
        notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": str(project)}}
    )
    client.execute(env=os.environ.copy())
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
