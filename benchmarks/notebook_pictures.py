"""Run notebooks on what the last run has left, and keep their pictures and the executed notebooks.

    python benchmarks/notebook_pictures.py FOLDER [--notebooks visual_words patch_graph ...]

Run it in the project's folder, after `kedro run`. Each picture is FOLDER/<notebook>_<number>.png, numbered from 0;
the notebooks with their outputs lie beside them. Ends with an error that names the notebook whose cell failed.
"""

import argparse
import base64
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

NOTEBOOKS = Path(__file__).resolve().parents[1] / "notebooks"


def execute(path: Path, folder: Path, timeout: int) -> int:
    """Run a notebook in the current folder; return how many pictures it drew."""
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(notebook, timeout=timeout, kernel_name="python3", resources={"metadata": {"path": "."}})
    try:
        client.execute()
    except CellExecutionError as error:
        sys.exit(f"{path}: {error}")
    nbformat.write(notebook, folder / path.name)
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    pictures = [output.data["image/png"] for output in outputs if "image/png" in output.get("data", {})]
    for number, picture in enumerate(pictures):
        (folder / f"{path.stem}_{number}.png").write_bytes(base64.b64decode(picture))
    return len(pictures)


def main() -> int:
    """Run the notebooks that are named, or all."""
    known = sorted(path.stem for path in NOTEBOOKS.glob("*.ipynb"))
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--notebooks", nargs="+", default=known, choices=known)
    parser.add_argument("--timeout", type=int, default=1800, help="seconds for one cell")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    for name in options.notebooks:
        n = execute(NOTEBOOKS / f"{name}.ipynb", options.folder, options.timeout)
        print(f"{name}: {n} pictures", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
