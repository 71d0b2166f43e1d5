"""What a per-scene stage hands to a scene store: tasks, and handles of what they read."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Any

from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError, ParameterError
from mlsroad_pipeline.execution.digests import digest_file
from mlsroad_pipeline.execution.fingerprints import qualified_name
from mlsroad_pipeline.execution.storage import SceneStorage


@dataclass(frozen=True)
class SceneFailure:
    """Why one scene has no result.

    Parameters
    ----------
    scene : str
        The scene.
    source : str or None
        The source files, where they are known.
    cause : str
        Type and message of the error.
    traceback : str
        The worker's traceback; empty where there is none.
    """

    scene: str
    source: str | None
    cause: str
    traceback: str = field(default="", repr=False)

    def __str__(self) -> str:
        """Return one line with the scene, its source and the cause."""
        return f"scene {self.scene!r}{f' ({self.source})' if self.source else ''}: {self.cause}"


class SceneError(MlsRoadError):
    """Scenes of a stage failed; the others are stored, and another run computes only what is missing.

    Parameters
    ----------
    stage : str
        The store's name.
    failures : tuple of SceneFailure
        What failed.
    n_scenes : int
        How many scenes the stage has.
    """

    def __init__(self, stage: str, failures: tuple[SceneFailure, ...], n_scenes: int) -> None:
        self.stage = stage
        self.failures = failures
        self.n_scenes = n_scenes
        lines = "\n".join(f"  {failure}" for failure in failures)
        super().__init__(f"stage {stage!r}: {len(failures)} of {n_scenes} scenes failed:\n{lines}")

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by arguments: an exception would otherwise be rebuilt from its message."""
        return type(self), (self.stage, self.failures, self.n_scenes)


@dataclass(frozen=True)
class SourceFile:
    """A raw input: a file, or a folder with all that is below it. The function gets its path.

    Parameters
    ----------
    path : str
        A path or URL. Its name and its content count in fingerprints, where it lies does not.
    """

    path: str

    def load(self) -> Any:
        """Return the path; subclasses read the file instead."""
        return str(self.path)

    def fingerprint_data(self) -> Any:
        """Return name and content digest; raises ReadError if the file cannot be read."""
        path = str(self.path)
        return {"file": PurePosixPath(path).name, "content": digest_file(path)}


@dataclass(frozen=True)
class StoredResult:
    """A handle of a stored result, tiny and picklable; the worker that needs the result loads it.

    Parameters
    ----------
    url : str
        The store.
    key : str
        The scene.
    fingerprint : str
        Digest of the stored content (of `part`, where one is chosen).
    part : str, optional
        Which part of the result; None is the whole.
    storage_options : mapping, optional
        What the store's file system is opened with.
    mapped : bool, default False
        Map the arrays of local files into memory, read-only: a function that takes a few rows of large arrays reads
        no more than those.
    """

    url: str
    key: str
    fingerprint: str
    part: str | None = None
    storage_options: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)
    mapped: bool = field(default=False, compare=False)

    def load(self) -> Any:
        """Read the result from storage.

        Raises
        ------
        ReadError
            If it is not there, has been computed anew since, or cannot be read.
        """
        storage = SceneStorage(self.url, self.storage_options)
        return storage.load(self.key, fingerprint=self.fingerprint, part=self.part, mapped=self.mapped)

    def fingerprint_data(self) -> Any:
        """Return what stands for the result in the fingerprints of tasks that read it."""
        return {"stored": self.fingerprint}


@dataclass(frozen=True)
class Deferred:
    """Handles that the function itself loads, one by one, because all of them together may be too large.

    Parameters
    ----------
    handles : tuple of StoredResult
        The handles.
    """

    handles: tuple[StoredResult, ...]

    def load(self) -> tuple[StoredResult, ...]:
        """Return the handles as they are."""
        return self.handles

    def fingerprint_data(self) -> Any:
        """Return what stands for the results in fingerprints."""
        return [handle.fingerprint_data() for handle in self.handles]


@dataclass(frozen=True)
class SceneTask:
    """The call that gives one scene's result: ``function(**loaded_inputs, **parameters)``, run in a worker.

    Parameters
    ----------
    function : callable
        A function at the top level of a module. It returns what `scene_results` can store: a PointCloud, a
        DataFrame, a mapping of str to arrays, or a mapping of part name to those.
    inputs : mapping of str to object
        Keyword arguments; `StoredResult` are loaded and `SourceFile` become paths, also inside lists, tuples and
        mappings. Anything else is passed on as it is.
    parameters : mapping of str to object, optional
        The other keyword arguments: plain values, dataclasses, paths, arrays, estimators.
    outputs : sequence of str, optional
        Files outside of the store that the function writes; where one is missing, the stored result does not count.

    Raises
    ------
    ParameterError
        If the function is a lambda, a closure, a partial or a bound method, if a name stands in both mappings, if the
        function does not take these arguments, or if a handle stands among the parameters.
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
                raise ParameterError(f"{name}: {parameter!r} is a {type(value).__name__}: it belongs into the inputs")
        try:
            signature = inspect.signature(self.function)
        except ValueError:  # some built-in functions do not tell theirs
            return
        try:
            signature.bind(**self.inputs, **self.parameters)
        except TypeError as error:
            raise ParameterError(f"{name}: {error}") from error

    def sources(self) -> list[str]:
        """Return the paths of the source files among the inputs."""
        return [item.path for value in self.inputs.values() for item in _flatten(value) if isinstance(item, SourceFile)]


def scene_tasks(
    scenes: Iterable[str],
    function: Callable[..., Any],
    inputs: Mapping[str, Any],
    parameters: Mapping[str, Any] | None = None,
) -> dict[str, SceneTask]:
    """Name the same work for each scene.

    Raises
    ------
    ParameterError
        If `SceneTask` refuses the function or its arguments.
    """
    return {
        key: SceneTask(
            function,
            {name: given if isinstance(given, SourceFile) else given[key] for name, given in inputs.items()},
            parameters or {},
        )
        for key in scenes
    }


def load_inputs(value: Any) -> Any:
    """Replace handles by what they stand for, inside lists, tuples and mappings too."""
    if isinstance(value, StoredResult | SourceFile | Deferred):
        return value.load()
    if isinstance(value, Mapping):
        return {name: load_inputs(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [load_inputs(item) for item in value]
    return value


def _flatten(value: Any) -> list[Any]:
    if isinstance(value, Mapping):
        return [leaf for item in value.values() for leaf in _flatten(item)]
    if isinstance(value, list | tuple):
        return [leaf for item in value for leaf in _flatten(item)]
    return [value]
