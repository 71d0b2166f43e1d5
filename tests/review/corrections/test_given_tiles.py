"""Learning from the results of given labels: the tiles of a file have the labels that were written."""

import numpy as np

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.algorithms.core.stage_parameters import GroundParameters
from mlsroad_pipeline.algorithms.models.given_labels.labeller import given_bundle
from mlsroad_pipeline.algorithms.models.labelling import label_softly
from mlsroad_pipeline.review.corrections.object_answers import TileGrid

SCHEME = ClassScheme("two", ("ground", "pole"), (("road",), ("post",)), (), (2, 64))


def test_tiles_have_the_labels_of_the_file(rng):
    xyz = np.concatenate([rng.random((4000, 3)) * [12, 12, 0.02], rng.random((300, 3)) * [0.1, 0.1, 4] + [6, 6, 0]])
    codes = np.where(xyz[:, 2] > 0.02, 64, 2).astype(np.uint8)
    columns = {"classification": codes, "confidence": np.full(len(codes), 0.7, np.float32), "other": codes}
    grid = TileGrid(PointCloud(xyz, columns, np.array([400.0, 500.0, 10.0])))
    tiles = list(grid.described(grid.cell, ground=GroundParameters(), voxel_size=0.2))
    assert sum(int(tile.core.sum()) for tile in tiles) == len(xyz)
    for tile in tiles:
        soft = label_softly(given_bundle(SCHEME), tile.scene)
        assert np.array_equal(SCHEME.codes()[soft.labels], codes[tile.rows]) and "other" not in tile.scene
