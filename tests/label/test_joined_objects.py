"""Joined objects: scenes are read once where they fit into memory; a limit of the distance needs a path."""

import pandas as pd
import pytest

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.label import joined_objects
from mlsroad_pipeline.label.inventory import check_paths
from mlsroad_pipeline.surveys.parameters import LabelParameters


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


def test_a_limit_needs_a_path(tmp_path):
    given = {"survey": "a.laz", "output": str(tmp_path)}
    without_path = {name: Counted(name, 0) for name in ("survey.north", "survey._")}
    for stored in without_path.values():
        stored.table = {}
    check_paths(without_path, LabelParameters(**given))
    with pytest.raises(ParameterError, match=r"label\.within 30 m: north has no path"):
        check_paths(without_path, LabelParameters(**given, within=30.0))
    with pytest.raises(ParameterError, match=r"label\.within 30 m: the survey has no path"):
        check_paths({"survey._": without_path["survey._"]}, LabelParameters(**given, within=30.0))
    with pytest.raises(ParameterError, match="label.within must be a finite number > 0, got -3"):
        LabelParameters(**given, within=-3)
