"""Fingerprints of tasks: digests that change whenever a stored result has to be computed again.

A fingerprint covers the function (qualified name, reachable source files), its inputs and parameters, and the versions
of the numerical packages. It excludes what cannot change a result, such as the location of the project on disk, so
that a copied project keeps its results.
"""

import ast
import dataclasses
import enum
import functools
import importlib.metadata
import inspect
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path, PurePath
from typing import Any, Protocol, runtime_checkable

import joblib
import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.execution.digests import digest_file, digest_json, digest_local_file

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
        stat = file.stat()
        waiting += _imports(file, stat.st_mtime_ns, stat.st_size)
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


@functools.cache
def _imports(file: Path, _modified: int, _size: int) -> list[str]:
    """Return the names that a source file imports: modules, and names imported from modules."""
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
    parts = _module_name(file).split(".")
    return [*names, *(".".join(parts[:k]) for k in range(2, len(parts)))]  # parent packages are imported with a module


def _module_name(file: Path) -> str:
    parts = file.relative_to(project_folder()).with_suffix("").parts
    return ".".join((PROJECT, *(parts[:-1] if parts[-1] == "__init__" else parts)))


NUMERICAL_PACKAGES = (
    "numpy", "scipy", "numba", "scikit-learn", "open3d", "laspy", "torch", "PyMaxflow",
    "onnxruntime", "onnxruntime-gpu",
)  # fmt: skip
"""Packages whose versions, if installed, are part of every fingerprint: results may differ between versions."""


@runtime_checkable
class Fingerprinted(Protocol):
    """Value that defines its own representation in fingerprints."""

    def fingerprint_data(self) -> Any:
        """Return plain data (str, numbers, lists, mappings) that changes whenever the value does."""


def _digests(files: Iterable[Path], folder: Path) -> list[list[str]]:
    return [[file.relative_to(folder).as_posix(), digest_local_file(str(file))] for file in sorted(files)]


@functools.lru_cache(maxsize=1)
def _library_digests() -> list[list[str]]:
    """Return the digests of the whole library, once per process: later edits do not change the code it has loaded."""
    return _digests(all_sources(), project_folder())


@functools.lru_cache(maxsize=1)
def package_versions() -> dict[str, str]:
    """Return the versions of the installed `NUMERICAL_PACKAGES` without importing them."""
    versions = {}
    for package in NUMERICAL_PACKAGES:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return versions


def describe_sources(module_names: Iterable[str]) -> list[Any]:
    """Return digests of all source files of this project that functions of the named modules can reach.

    A function of `algorithms`, `simulation` or `studies` reaches the imports of its module. A function of another
    package reaches the whole library, since a model names its labelling function, and the folder of its module.
    """
    names, project = sorted(set(module_names)), project_folder()
    outside = [name for name in names if not in_science(name)]
    library = _library_digests() if outside else _digests(reachable_sources(names), project)
    sources: list[Any] = [["library", library]]
    for name in outside:
        file = getattr(sys.modules.get(name), "__file__", None)
        if file is None or not Path(file).is_file():
            continue
        if name.split(".")[0] != PROJECT:
            sources.append([Path(file).name, digest_file(file)])
        elif name.split(".")[1] not in LIBRARY:
            beside = Path(file).parent
            sources.append([name, _digests(beside.rglob("*.py"), beside)])
    return sources


@functools.lru_cache(maxsize=1)
def code_digest() -> str:
    """Return a digest of the library's sources, its shipped models and the numerical packages."""
    cards = _digests(project_folder().glob("datasets/**/registry.json"), project_folder())
    return digest_json([_library_digests(), cards, package_versions()])


@functools.lru_cache(maxsize=1)
def installation() -> str:
    """Return a digest of all sources of the project, and the versions that results may depend on, in one line."""
    folder = project_folder()
    files = [*folder.rglob("*.py"), *folder.glob("datasets/**/registry.json")]
    versions = ", ".join(f"{name} {version}" for name, version in sorted(package_versions().items()))
    python = f"Python {sys.version_info.major}.{sys.version_info.minor}"
    return f"sources {digest_json(_digests(files, folder))[:12]}, {python}, {versions}"


def qualified_name(function: Callable[..., Any]) -> str:
    """Return `module:name` of a function that a worker can import."""
    module, name = getattr(function, "__module__", None), getattr(function, "__qualname__", None)
    if module and name and "<" not in name:
        try:
            resolved = functools.reduce(getattr, name.split("."), sys.modules[module])
        except (KeyError, AttributeError):
            resolved = None
        if resolved is function:
            return f"{module}:{name}"
    raise ParameterError(f"a scene task needs a function that a module defines at its top level, got {function!r}")


class Fingerprinter:
    """Compute fingerprints of tasks; digests of sources and large values are cached for the lifetime of the object."""

    def __init__(self) -> None:
        self._hashes: dict[int, tuple[Any, str]] = {}
        self._sources: dict[tuple[str, ...], list[Any]] = {}
        self._types: set[str] = set()  # modules of `SCIENCE` that define the types of described values

    def task(
        self,
        function: Callable[..., Any],
        inputs: Mapping[str, Any],
        parameters: Mapping[str, Any],
        *,
        validator: Callable[..., Any] | None = None,
    ) -> str:
        """Return the fingerprint of a call."""
        functions = [function] if validator is None else [function, validator]
        self._types = set()
        call = {
            "functions": [qualified_name(f) for f in functions],
            "inputs": [[name, self.describe(inputs[name])] for name in sorted(inputs)],
            "parameters": [[name, self.describe(parameters[name])] for name in sorted(parameters)],
        }
        modules = tuple(sorted({f.__module__ for f in functions} | self._types))
        if modules not in self._sources:
            self._sources[modules] = describe_sources(modules)
        return digest_json({**call, "sources": self._sources[modules], "packages": package_versions()})

    def describe(self, value: Any) -> Any:
        """Return plain data that represents a value.

        NumPy numbers equal Python numbers, tuples equal lists, paths equal strings. The order of a mapping counts,
        since labels follow the order of a class scheme.
        """
        if isinstance(value, list | tuple):
            described: Any = [self.describe(item) for item in value]
        elif isinstance(value, Mapping):
            described = {"mapping": [[self.describe(key), self.describe(item)] for key, item in value.items()]}
        elif isinstance(value, set | frozenset):
            described = {"set": sorted((self.describe(item) for item in value), key=digest_json)}
        elif isinstance(value, Fingerprinted) and not isinstance(value, type):
            described = self.describe(value.fingerprint_data())
        elif isinstance(value, PurePath):
            described = value.as_posix()
        elif isinstance(value, np.bool_ | np.number | np.str_):
            described = value.item()
        elif value is None or type(value) in (bool, int, float, str):
            described = value
        else:
            described = self._describe_object(value)
        return described

    def _describe_object(self, value: Any) -> Any:
        kind = f"{type(value).__module__}.{type(value).__qualname__}"
        if in_science(type(value).__module__):
            self._types.add(type(value).__module__)
        if isinstance(value, enum.Enum):
            return {"enum": kind, "name": value.name}
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            fields = [[f.name, self.describe(getattr(value, f.name))] for f in dataclasses.fields(value)]
            return {"dataclass": kind, "fields": fields}
        if inspect.ismethod(value) and value.__name__ == "load":  # of a data set of Kedro: its content counts
            content = value()
            return {"loaded": self.describe(content)}
        if inspect.isroutine(value) or isinstance(value, type):
            return {"function": qualified_name(value), "sources": describe_sources([value.__module__])}
        return {"object": kind, "hash": self._hash(value, kind)}

    def _hash(self, value: Any, kind: str) -> str:
        known = self._hashes.get(id(value))
        if known is None:
            try:
                # The value is kept with its hash, so that its id is not reused.
                known = self._hashes[id(value)] = (value, str(joblib.hash(value)))
            except Exception as error:
                raise ParameterError(f"a value of {kind} cannot be part of a scene task: {error}") from error
        return known[1]
