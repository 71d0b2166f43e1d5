"""Docstrings: those of the reference have all sections of numpydoc, all others a summary; their examples are right."""

import ast
import doctest
import importlib
import inspect
import re
import tomllib
from pathlib import Path

import pytest
from numpydoc.validate import validate

from mlsroad_pipeline import simulation

REPOSITORY = Path(__file__).resolve().parents[1]
SOURCES = REPOSITORY / "src/mlsroad_pipeline"
CHECKS = set(tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]["numpydoc_validation"]["checks"])
EXPORTED = sorted(
    name
    for page in (REPOSITORY / "docs/reference").glob("*.md")
    for name in re.findall(r"^::: (\S+)", page.read_text(), re.M)
)
"""Modules and single names in the reference, and the simulator, of which the names in `__all__` are shown."""
WITH_EXAMPLES = sorted(path for path in SOURCES.rglob("*.py") if ">>> " in path.read_text(encoding="utf-8"))


def members(module):
    """Yield name, object and whether it overrides a method, of the functions, classes and methods of a module."""
    for name, value in vars(module).items():
        if name.startswith("_") or getattr(value, "__module__", None) != module.__name__:
            continue
        if inspect.isclass(value):
            yield f"{module.__name__}.{name}", value, False
            for method, inner in vars(value).items():
                if not method.startswith("_") and (
                    inspect.isfunction(inner) or isinstance(inner, property | classmethod)
                ):
                    yield f"{module.__name__}.{name}.{method}", inner, _overrides(value, method)
        elif inspect.isfunction(value) or hasattr(value, "py_func"):
            yield f"{module.__name__}.{name}", value, False


def exports(name):
    """Yield name, object and whether it overrides a method, of what the reference shows of a module or of one name."""
    if name == simulation.__name__:
        values = {one: getattr(simulation, one) for one in simulation.__all__}
        yield from ((f"{name}.{one}", value, False) for one, value in values.items() if not isinstance(value, dict))
        return
    try:
        yield from members(importlib.import_module(name))
    except ModuleNotFoundError:
        module, _, own = name.rpartition(".")
        yield name, getattr(importlib.import_module(module), own), False


def _overrides(owner, method):
    """Return whether a base class of this project has the method: its docstring has the sections."""
    bases = [base for base in owner.__mro__[1:] if base.__module__.startswith("mlsroad_pipeline.")]
    return any(method in vars(base) for base in bases)


def spared(value):
    """Return whether a summary suffices.

    That holds for a one-line docstring of at most one parameter beside `self`; for Numba kernels, whose flat arrays the
    calling function documents; for records with a section `Attributes`; and for protocols.
    """
    if hasattr(value, "py_func"):
        return True
    if inspect.isclass(value):
        return "\nAttributes\n" in (inspect.getdoc(value) or "") or getattr(value, "_is_protocol", False)
    function = value.fget if isinstance(value, property) else getattr(value, "__func__", value)
    own = len(inspect.signature(function).parameters) - ("." in function.__qualname__)
    return own <= 1 and len((inspect.getdoc(function) or "").splitlines()) <= 1


def test_the_reference_is_documented():
    wrong = []
    for exported in EXPORTED:
        for member, value, overrides in exports(exported):
            for code, message in validate(member)["errors"]:
                if code in CHECKS and not (code[:2] in ("PR", "RT") and (overrides or spared(value))):
                    wrong.append(f"{member}: {code} {message}")
    assert wrong == []


def test_everything_public_has_a_docstring():
    missing = []
    for path in sorted(SOURCES.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        owners = [tree, *(node for node in tree.body if isinstance(node, ast.ClassDef) and node.name[0] != "_")]
        kinds = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
        nodes = [tree, *(node for owner in owners for node in owner.body if isinstance(node, kinds))]
        for node in nodes:
            name = getattr(node, "name", "")
            overload = any(ast.unparse(one) == "overload" for one in getattr(node, "decorator_list", ()))
            if not name.startswith("_") and not overload and not ast.get_docstring(node):
                missing.append(f"{path.relative_to(SOURCES)}: {name or 'module'}")
    assert missing == []


@pytest.mark.parametrize("path", WITH_EXAMPLES, ids=lambda path: path.stem)
def test_examples_give_what_they_show(path, tmp_path):
    module = importlib.import_module(".".join(path.relative_to(SOURCES.parent).with_suffix("").parts))
    done = doctest.testmod(module, extraglobs={"tmp_path": tmp_path})
    assert done.failed == 0  # doctest prints the example and what it gave
    assert done.attempted == path.read_text(encoding="utf-8").count(">>> ")
