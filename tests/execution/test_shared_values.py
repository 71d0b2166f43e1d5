"""Parameters that tasks share through a file."""

import pickle

import numpy as np
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.execution.shared_values import load_shared, share_values
from mlsroad_pipeline.execution.store_files import StoreFiles
from mlsroad_pipeline.execution.task import SceneTask


class Trap:
    def __reduce__(self):
        return (pytest.fail, ("code of the file was run",))


def test_a_replaced_file_is_not_unpickled(tmp_path):
    large = np.arange(300_000.0)
    tasks = [SceneTask(np.full, {"shape": 1}, {"fill_value": large}) for _ in range(2)]
    shared = share_values(tasks, StoreFiles.at(str(tmp_path)))
    (file,) = (tmp_path / ".shared").iterdir()
    assert pickle.loads(file.read_bytes()).tolist() == large.tolist()
    file.write_bytes(pickle.dumps(Trap()))
    with pytest.raises(ReadError, match=rf"{file.name} is damaged or was replaced: start the same command again"):
        load_shared(shared[0].parameters)
