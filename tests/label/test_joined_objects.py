"""Objects of the scenes of a pass are read once where they fit into memory, and again where they do not."""

import pandas as pd
import pytest

from mlsroad_pipeline.label import joined_objects


class Counted:
    """A stored table that counts how often it is read."""

    def __init__(self, key, rows):
        self.key, self.table, self.reads = key, pd.DataFrame({"fragment": range(rows)}), 0

    def load(self):
        self.reads += 1
        return self.table


@pytest.mark.parametrize(("limit", "reads"), [(0, [2, 2, 2]), (4, [1, 2, 1]), (100, [1, 1, 1])])
def test_scenes_stay_in_memory_up_to_a_limit(monkeypatch, limit, reads):
    monkeypatch.setattr(joined_objects, "_KEPT_ROWS", limit)
    objects, fragments, evidence = ([Counted(f"s{i}", rows) for i, rows in enumerate((3, 5, 1))] for _ in range(3))
    scenes = joined_objects._StoredObjects(objects, fragments, evidence)
    for _ in range(2):
        for i, scene in enumerate(scenes):
            assert scene.scene == f"s{i}"
            assert scene.fragments is fragments[i].table and scene.evidence is evidence[i].table
    assert [table.reads for table in fragments] == [table.reads for table in objects] == reads
    assert [table.reads for table in evidence] == reads


def test_files_of_two_passes_have_different_numbers():
    stored = [Counted(f"survey.{name}.scene_00000", 0) for name in ("north", "south")]
    for result in stored:
        result.table = pd.DataFrame({"file": [0, 1]})
    north, south = joined_objects._sightings(stored, ["survey.north", "survey.south"])
    assert [north.scene, south.scene] == [result.key for result in stored]
    assert len({*north.table["file"], *south.table["file"]}) == 4
