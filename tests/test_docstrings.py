"""Docstrings of the public interface, checked by numpydoc."""

import importlib
import inspect
import pkgutil
import re
import tomllib
from pathlib import Path

import pytest
from numpydoc.validate import validate

import mlsroad_pipeline
from mlsroad_pipeline import simulation

REPOSITORY = Path(__file__).resolve().parents[1]
CHECKS = set(tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]["numpydoc_validation"]["checks"])
SECTIONS = {"PR01", "PR02", "PR03", "PR07", "RT01", "RT03"}
"""Checks of the sections; some members are exempt, see `spared`."""
EXPORTED = {
    name
    for page in sorted((REPOSITORY / "docs/reference").glob("*.md"))
    for name in re.findall(r"^::: (\S+)", page.read_text(), re.M)
}
"""Packages, modules and functions in the reference; their docstrings have all sections."""
GENERATED = {"mlsroad_pipeline.model_store.registered_model_code"}
"""Runs only inside MLflow."""


def modules():
    found = pkgutil.walk_packages(mlsroad_pipeline.__path__, "mlsroad_pipeline.")
    return sorted(
        info.name
        for info in found
        if not any(part.startswith("_") for part in info.name.split(".")[1:]) and info.name not in GENERATED
    )


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


def _overrides(owner, method):
    """Return whether a base class of this project has the method: its docstring has the sections."""
    bases = [base for base in owner.__mro__[1:] if base.__module__.startswith("mlsroad_pipeline.")]
    return any(method in vars(base) for base in bases)


def exported(name):
    """Return whether the reference documents a member, by itself or within its module or package."""
    return any(name == other or name.startswith(f"{other}.") for other in EXPORTED)


def spared(value):
    """Return whether a summary suffices.

    That holds for a one-line docstring of at most one parameter beside `self`; for Numba kernels, whose flat arrays the
    calling function documents; for records with a section `Attributes`; for protocols; and for the builders of the
    simulated street, behind the names that the simulator exports.
    """
    if hasattr(value, "py_func"):
        return True
    if inspect.isclass(value) and _builds_the_street(value):
        return True
    if inspect.isclass(value):
        return "\nAttributes\n" in (inspect.getdoc(value) or "") or getattr(value, "_is_protocol", False)
    function = value.fget if isinstance(value, property) else getattr(value, "__func__", value)
    if _builds_the_street(function):
        return True
    own = len(inspect.signature(function).parameters) - ("." in function.__qualname__)
    return own <= 1 and len((inspect.getdoc(function) or "").splitlines()) <= 1


def _builds_the_street(member):
    inside = member.__module__.startswith(f"{simulation.__name__}.")
    return inside and member.__qualname__.partition(".")[0] not in simulation.__all__


@pytest.mark.parametrize("name", modules())
def test_public_interface_is_documented(name):
    module = importlib.import_module(name)
    assert inspect.getdoc(module), f"{name} has no docstring"
    wrong = []
    for member, value, overrides in members(module):
        for code, message in validate(member)["errors"]:
            if code in CHECKS and not (code in SECTIONS and (overrides or spared(value) or not exported(member))):
                wrong.append(f"{member}: {code} {message}")
    assert wrong == []
