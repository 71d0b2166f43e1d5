"""Source files reachable from a module by imports: a change in one of them invalidates stored results."""

from __future__ import annotations

import ast
import functools
from collections.abc import Iterable
from pathlib import Path

PROJECT = "mlsroad_pipeline"
SCIENCE = ("algorithms", "simulation", "papers")
"""Packages whose modules reach only what they import."""

LIBRARY = (
    *SCIENCE,
    "formats",
    "execution",
    "surveys",
    "datasets",
    "inventory_files",
    "model_store",
    "reporting",
    "label",
)
"""Packages reachable from functions outside of `SCIENCE`, since models name their labelling function."""


@functools.cache
def project_folder() -> Path:
    """Return the folder of the project's sources."""
    return Path(__file__).parents[1]


def reachable_sources(module_names: Iterable[str]) -> list[Path]:
    """Return the source files of `SCIENCE` that modules reach by imports, including imports inside functions.

    A module that calls `import_module` reaches its whole package, such as all of `algorithms`, and `papers`.
    """
    waiting, reached = list(module_names), set[Path]()
    seen: set[str] = set()
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        file = source_of(name)
        if file is None or file in reached:
            continue
        reached.add(file)
        waiting += _imports(file)
    return sorted(reached)


def all_sources() -> list[Path]:
    """Return all source files of `LIBRARY`."""
    return sorted(file for package in LIBRARY for file in (project_folder() / package).rglob("*.py"))


def in_science(module_name: str) -> bool:
    """Return whether a module lies in one of the packages of `SCIENCE`."""
    parts = module_name.split(".")
    return parts[0] == PROJECT and len(parts) > 1 and parts[1] in SCIENCE


def source_of(module_name: str) -> Path | None:
    """Return the source file of a module of `SCIENCE`, or None for other names."""
    if not in_science(module_name):
        return None
    place = project_folder().joinpath(*module_name.split(".")[1:])
    for file in (place.with_suffix(".py"), place / "__init__.py"):
        if file.is_file():
            return file
    return None


def _imports(file: Path) -> list[str]:
    """Return the names that a source file imports: modules, and names imported from modules."""
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
        packages = {file.relative_to(project_folder()).parts[0], "papers"}  # the table of methods names those of papers
        names += [_module_name(other) for name in sorted(packages) for other in (project_folder() / name).rglob("*.py")]
    return [*names, *_packages(_module_name(file))]


def _module_name(file: Path) -> str:
    parts = file.relative_to(project_folder()).with_suffix("").parts
    return ".".join((PROJECT, *(parts[:-1] if parts[-1] == "__init__" else parts)))


def _packages(module_name: str) -> list[str]:
    """Return the parent packages of a module, which are imported with it."""
    parts = module_name.split(".")
    return [".".join(parts[:k]) for k in range(2, len(parts))]
