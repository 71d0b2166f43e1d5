"""Sources that a module can reach: results are computed again when one of them changes."""

from __future__ import annotations

import ast
import functools
from collections.abc import Iterable
from pathlib import Path

PROJECT = "mlsroad_pipeline"
SCIENCE = ("algorithms", "simulation", "studies")
"""Packages whose modules reach only what they import."""

LIBRARY = (*SCIENCE, "formats", "execution", "surveys", "datasets", "reporting", "label")
"""Packages that a function outside of `SCIENCE` may reach: models name the function that labels with them."""


@functools.cache
def project_folder() -> Path:
    """Return where the project's sources lie."""
    return Path(__file__).parents[1]


def reachable_sources(module_names: Iterable[str]) -> list[Path]:
    """Find the sources of `SCIENCE` that modules can reach through their imports, also those inside functions.

    A module that imports by name can reach its whole package: all of `algorithms`, for instance.
    """
    waiting, found = list(module_names), set[Path]()
    seen: set[str] = set()
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        file = source_of(name)
        if file is None or file in found:
            continue
        found.add(file)
        waiting += _imports(file)
    return sorted(found)


def all_sources() -> list[Path]:
    """Return all sources of `LIBRARY`."""
    return sorted(file for package in LIBRARY for file in (project_folder() / package).rglob("*.py"))


def in_science(module_name: str) -> bool:
    """Return whether a module lies in one of the packages of `SCIENCE`."""
    parts = module_name.split(".")
    return parts[0] == PROJECT and len(parts) > 1 and parts[1] in SCIENCE


def source_of(module_name: str) -> Path | None:
    """Return the source file of a module of `SCIENCE`."""
    if not in_science(module_name):
        return None
    place = project_folder().joinpath(*module_name.split(".")[1:])
    for file in (place.with_suffix(".py"), place / "__init__.py"):
        if file.is_file():
            return file
    return None


def _imports(file: Path) -> list[str]:
    """Return the names of what a source imports; names of what it imports from modules are among them."""
    stat = file.stat()
    return _parsed_imports(file, stat.st_mtime_ns, stat.st_size)


@functools.cache
def _parsed_imports(file: Path, _modified: int, _size: int) -> list[str]:
    names: list[str] = []
    by_name = False
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        by_name |= "import_module" in (getattr(node, "id", None), getattr(node, "attr", None))
    if by_name:
        package = file.relative_to(project_folder()).parts[0]
        names += [_module_name(other) for other in (project_folder() / package).rglob("*.py")]
    return [*names, *_packages(_module_name(file))]


def _module_name(file: Path) -> str:
    parts = file.relative_to(project_folder()).with_suffix("").parts
    return ".".join((PROJECT, *(parts[:-1] if parts[-1] == "__init__" else parts)))


def _packages(module_name: str) -> list[str]:
    """Return the packages that a module lies in: they are imported with it."""
    parts = module_name.split(".")
    return [".".join(parts[:k]) for k in range(2, len(parts))]
