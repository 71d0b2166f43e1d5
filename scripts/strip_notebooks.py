"""Remove outputs and execution counts from notebooks, in place; exit 1 where something changed."""

import sys
from pathlib import Path

import nbformat


def strip(path: Path) -> bool:
    """Strip one notebook and tell whether it changed.

    Parameters
    ----------
    path : Path
        The notebook.

    Returns
    -------
    bool
        True if it had outputs or execution counts.
    """
    notebook = nbformat.read(path, as_version=4)
    changed = False
    for cell in notebook.cells:
        if cell.cell_type == "code" and (cell.outputs or cell.execution_count is not None):
            cell.outputs, cell.execution_count, changed = [], None, True
    if changed:
        nbformat.write(notebook, path)
    return changed


if __name__ == "__main__":
    sys.exit(any([strip(Path(name)) for name in sys.argv[1:]]))
