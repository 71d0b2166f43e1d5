"""Large parameters shared by the tasks of a stage, such as a trained model: written once, read once per worker.

Otherwise the model would be pickled, sent and rebuilt for every scene.
"""

import pickle
import threading
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cloudpickle  # type: ignore[import-untyped]  # it has no stubs

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.execution.digests import new_digest
from mlsroad_pipeline.execution.store_files import SHARED, StoreFiles
from mlsroad_pipeline.execution.task import SceneTask

SHARED_FROM = 1 << 20
"""Smallest pickled size of a shared value, bytes."""

_PLAIN = (type(None), bool, int, float, str)

_lock = threading.Lock()
_loaded: dict[tuple[str, str], Any] = {}


@dataclass(frozen=True)
class SharedValue:
    """Reference to a shared parameter: the store that holds it and the name of its file."""

    files: StoreFiles
    name: str

    def load(self) -> Any:
        """Return the value; a worker reads it once and caches it until its next stage."""
        key = (self.files.url, self.name)
        with _lock:
            if key not in _loaded:
                for other in [k for k in _loaded if k[0] != self.files.url]:
                    del _loaded[other]
                _loaded[key] = pickle.loads(self._content())
            return _loaded[key]

    def _content(self) -> bytes:
        """Return the file's content; raise ReadError where its digest is not the one in its name: a pickle is code."""
        data = self.files.read_bytes(self.name)
        if f"{SHARED}/{new_digest(data).hexdigest()}.pickle" != self.name:
            raise ReadError(f"{self.files.url}/{self.name} is damaged or was replaced: start the same command again")
        return data


def share_values(tasks: Sequence[SceneTask], files: StoreFiles) -> list[SceneTask]:
    """Return tasks in which large parameters common to several of them are replaced by references to files."""
    values = {id(value): value for task in tasks for value in task.parameters.values()}
    uses = Counter(id(value) for task in tasks for value in task.parameters.values())
    shared: dict[int, SharedValue] = {}
    for identity, count in uses.items():
        if count > 1 and not isinstance(values[identity], _PLAIN):
            data = cloudpickle.dumps(values[identity])
            if len(data) >= SHARED_FROM:
                shared[identity] = SharedValue(files, f"{SHARED}/{new_digest(data).hexdigest()}.pickle")
                with files.writing(shared[identity].name) as stream:
                    stream.write(data)
    return [
        replace(task, parameters={name: shared.get(id(value), value) for name, value in task.parameters.items()})
        for task in tasks
    ]


def load_shared(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Replace references to shared values by the values."""
    return {name: v.load() if isinstance(v, SharedValue) else v for name, v in parameters.items()}
