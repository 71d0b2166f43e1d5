"""Modules of `algorithms` open no file and name no orchestration or plotting, not even inside functions."""

import ast
from pathlib import Path

import pytest

ALGORITHMS = Path(__file__).resolve().parents[2] / "src/mlsroad_pipeline/algorithms"
FORBIDDEN_IMPORTS = {
    *("kedro", "kedro_datasets", "kedro_mlflow", "mlflow", "matplotlib"),
    *("pathlib", "os", "io", "shutil", "tempfile", "zipfile", "gzip", "sqlite3", "pickle", "fsspec"),
}
FILE_METHODS = {
    *("open", "read_text", "write_text", "read_bytes", "write_bytes", "mkdir", "touch", "unlink", "tofile"),
    *("to_csv", "to_parquet", "to_pickle", "savefig"),
}
FILE_FUNCTIONS = {
    *("np.load", "np.save", "np.savez", "np.savez_compressed", "np.loadtxt", "np.savetxt", "np.genfromtxt"),
    *("np.fromfile", "np.memmap", "torch.load", "torch.save", "json.load", "json.dump", "joblib.load", "joblib.dump"),
    *("pd.read_csv", "pd.read_parquet", "Image.open"),
}


def violations(source):
    """Return the forbidden imports and the calls that open a file, with their lines."""
    found = []
    for node in ast.walk(ast.parse(source)):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names if alias.name.partition(".")[0] in FORBIDDEN_IMPORTS]
        elif isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in FORBIDDEN_IMPORTS:
            names = [node.module]
        elif isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            is_method = isinstance(node.func, ast.Attribute) and node.func.attr in FILE_METHODS
            names = [called] if called in FILE_FUNCTIONS | {"open", "Path"} or is_method else []
        found += [f"line {node.lineno}: {name}" for name in names]
    return found


def test_modules_open_no_file_and_name_no_orchestration():
    found = {
        str(path.relative_to(ALGORITHMS)): violations(path.read_text("utf-8")) for path in ALGORITHMS.rglob("*.py")
    }
    assert len(found) > 100 and {path: wrong for path, wrong in found.items() if wrong} == {}


@pytest.mark.parametrize(
    "source",
    [
        "import mlflow.pyfunc",
        "def f():\n    from kedro.io import DataCatalog",
        "from matplotlib.figure import Figure",
        "from pathlib import Path",
        "open('a')",
        "source.read_text()",
        "Path(name).parent.mkdir(parents=True)",
        "arrays = np.load(name)",
        "torch.save(state, name)",
        "frame.to_parquet(name)",
    ],
)
def test_violations_are_seen(source):
    assert violations(source)


@pytest.mark.parametrize("source", ["import json\njson.loads(text)", "scheme.load(x)", "opened = is_open(door)"])
def test_harmless_calls_are_not(source):
    assert violations(source) == []
