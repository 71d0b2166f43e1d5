"""Tasks of a per-scene stage, and handles of their inputs."""

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError, ParameterError
from mlsroad_pipeline.execution.digests import digest_file
from mlsroad_pipeline.execution.fingerprints import qualified_name
from mlsroad_pipeline.execution.store import SceneStore


@dataclass(frozen=True)
class SceneFailure:
    """Failure of one scene."""

    scene: str
    source: str | None  # Source files, if known
    cause: str  # Type and message of the error
    traceback: str = field(default="", repr=False)  # That of the worker, if there is one

    def __str__(self) -> str:
        """Return one line with the scene, its source and the cause."""
        return f"scene {self.scene!r}{f' ({self.source})' if self.source else ''}: {self.cause}"


class SceneError(MlsRoadError):
    """Error of a stage with failed scenes; the other scenes are stored, and the next run computes the missing ones."""

    def __init__(self, stage: str, failures: tuple[SceneFailure, ...], n_scenes: int) -> None:
        self.stage = stage
        self.failures = failures
        self.n_scenes = n_scenes
        lines = "\n".join(f"  {failure}" for failure in failures)
        super().__init__(f"stage {stage!r}: {len(failures)} of {n_scenes} scenes failed:\n{lines}")

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arguments: by default an exception is rebuilt from its message."""
        return type(self), (self.stage, self.failures, self.n_scenes)


@dataclass(frozen=True)
class SourceFile:
    """Raw input file or folder; the function of the task receives its path.

    Fingerprints cover the name and the content, not the parent folder.
    """

    path: str  # A path or URL

    def load(self) -> Any:
        """Return the path; subclasses read the file instead."""
        return str(self.path)

    def fingerprint_data(self) -> Any:
        """Return name and content digest; raise ReadError if the file cannot be read."""
        path = str(self.path)
        return {"file": PurePosixPath(path).name, "content": digest_file(path)}


@dataclass(frozen=True)
class StoredResult:
    """Handle of a stored result, small and picklable; the worker loads the result."""

    url: str  # The store
    key: str  # The scene
    fingerprint: str  # Digest of the stored content, of `part` if given
    part: str | None = None  # Part of the result; None is the whole result
    # Options of the store's file system
    storage_options: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)
    # Map the arrays of local files into memory, copy-on-write: of large arrays only the rows in use are read
    mapped: bool = field(default=False, compare=False)

    def load(self) -> Any:
        """Read the result; raise ReadError if it is missing, has been replaced since, or cannot be read."""
        store = SceneStore(self.url, self.storage_options)
        return store.load(self.key, fingerprint=self.fingerprint, part=self.part, mapped=self.mapped)

    def fingerprint_data(self) -> Any:
        """Return the representation of the result in fingerprints of tasks that read it."""
        return {"stored": self.fingerprint}


@dataclass(frozen=True)
class Deferred:
    """Handles that the function loads itself, one by one, because all results together may exceed the memory."""

    handles: tuple[StoredResult, ...]

    def load(self) -> tuple[StoredResult, ...]:
        """Return the handles unchanged."""
        return self.handles

    def fingerprint_data(self) -> Any:
        """Return the representation of the results in fingerprints."""
        return [handle.fingerprint_data() for handle in self.handles]


@dataclass(frozen=True)
class SceneTask:
    """Call that computes the result of one scene in a worker: ``function(**loaded_inputs, **parameters)``.

    Parameters
    ----------
    function : callable
        A function at the top level of a module. It returns a PointCloud, a DataFrame, a mapping of str to arrays, or a
        mapping of part name to any of these (see `result_files`).
    inputs : mapping of str to object
        Keyword arguments. A `StoredResult` is loaded and a `SourceFile` becomes its path, also inside lists, tuples
        and mappings; other values are passed unchanged.
    parameters : mapping of str to object, optional
        The other keyword arguments: plain values, dataclasses, paths, arrays, estimators.
    outputs : sequence of str, optional
        Files outside of the store that the function writes; if one is missing, the task runs again.

    Raises
    ------
    ParameterError
        If the function is a lambda, a closure, a partial or a bound method, if a name is in both mappings, if the
        function does not accept these arguments, or if a handle is among the parameters.
    """

    function: Callable[..., Any]
    inputs: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    outputs: Sequence[str] = ()

    def __post_init__(self) -> None:
        name = qualified_name(self.function)
        twice = sorted(set(self.inputs) & set(self.parameters))
        if twice:
            raise ParameterError(f"{name}: {twice} are both inputs and parameters")
        for parameter, value in self.parameters.items():
            if isinstance(value, StoredResult | SourceFile):
                raise ParameterError(f"{name}: {parameter!r} is a {type(value).__name__}: pass it as an input")
        try:
            signature = inspect.signature(self.function)
        except ValueError:  # some built-in functions have no signature
            return
        try:
            signature.bind(**self.inputs, **self.parameters)
        except TypeError as error:
            raise ParameterError(f"{name}: {error}") from error

    def __call__(self) -> Any:
        """Return the result, computed here: what Kedro's own data sets do with a callable that they save."""
        return self.function(**load_inputs(self.inputs), **self.parameters)

    def sources(self) -> list[str]:
        """Return the paths of the source files among the inputs."""
        return [item.path for value in self.inputs.values() for item in _flatten(value) if isinstance(item, SourceFile)]


def scene_tasks(
    scenes: Iterable[str],
    function: Callable[..., Any],
    inputs: Mapping[str, Any],
    parameters: Mapping[str, Any] | None = None,
) -> dict[str, SceneTask]:
    """Create one task per scene.

    Each input maps scenes to the argument of that scene; a `SourceFile` is the same argument for all scenes.
    """
    return {
        key: SceneTask(
            function,
            {name: value if isinstance(value, SourceFile) else value[key] for name, value in inputs.items()},
            parameters or {},
        )
        for key in scenes
    }


def load_inputs(value: Any) -> Any:
    """Replace handles by their values, also inside lists, tuples and mappings.

    Handles are those of this module, tasks that nobody has stored, and the methods `load` that Kedro's
    `PartitionedDataset` gives for its partitions.
    """
    if isinstance(value, StoredResult | SourceFile | Deferred):
        return value.load()
    if isinstance(value, SceneTask) or is_loader(value):
        return value()
    if isinstance(value, Mapping):
        return {name: load_inputs(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [load_inputs(item) for item in value]
    return value


def is_loader(value: Any) -> bool:
    """Return whether a value is the method of a data set that loads it."""
    return inspect.ismethod(value) and value.__name__ == "load"


def load_all(results: Mapping[str, Any]) -> dict[str, Any]:
    """Return the results of all scenes: of a scene store, or of any data set of Kedro that keeps one per scene."""
    return {key: load_inputs(value) for key, value in results.items()}


def _flatten(value: Any) -> list[Any]:
    if isinstance(value, Mapping):
        return [leaf for item in value.values() for leaf in _flatten(item)]
    if isinstance(value, list | tuple):
        return [leaf for item in value for leaf in _flatten(item)]
    return [value]
