"""Tables of lines: those near a path."""

import numpy as np
import pandas as pd

from mlsroad_pipeline.algorithms.inventory.lines.extraction import line_row, lines_near
from mlsroad_pipeline.algorithms.scenes.trajectory import Trajectory


def test_lines_near_the_path_are_kept_whole_and_those_beyond_its_ends_are_far():
    path = Trajectory.from_positions(np.array([[0.0, 0, 0], [100, 0, 0]]))
    kerbs = [
        [[10, 4, 0], [60, 4, 0]],
        [[10, 20, 0], [60, 45, 0]],
        [[10, 40, 0], [60, 40, 0]],
        [[140, 0, 0], [150, 0, 0]],
    ]
    lines = pd.DataFrame([line_row("kerb", np.array(kerb, float), path) for kerb in kerbs])
    assert lines_near(lines, path, 30.0).index.tolist() == [0, 1]
    assert lines_near(lines.iloc[:0], path, 30.0).empty
