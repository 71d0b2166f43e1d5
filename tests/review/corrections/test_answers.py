"""Classes that decisions allow, and the points that they are about."""

import numpy as np
import pytest
from helpers.corrected import object_rows, write_inventory
from helpers.labelled import scheme

from mlsroad_pipeline.algorithms.core.classes import ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError, ReadError
from mlsroad_pipeline.review.corrections import Correction, open_corrections
from mlsroad_pipeline.review.corrections.answers import NamedClasses, answers_of_file, object_classes, unmatched_strokes
from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput
from mlsroad_pipeline.review.corrections.learning import check_learnable


@pytest.fixture
def named():
    schemes = {name: scheme(name) for name in ("common", "road_inventory", "oakland5", "asprs")}
    return NamedClasses(ClassScheme.from_config("road_inventory", schemes["road_inventory"]), schemes)


def names(named, allowed):
    return {named.scheme.classes[k] for k in np.flatnonzero(allowed)}


def test_names_of_other_schemes_allow_the_classes_that_they_hold(named):
    assert names(named, named.allowed("tree")) == {"tree"}
    assert names(named, named.allowed("ground")) == {"paved ground", "natural ground"}
    assert names(named, named.allowed("vegetation")) == {"tree", "low vegetation"}
    assert names(named, named.allowed("street furnitur")) == {"street furniture"}  # as a LAZ file names it
    assert names(named, named.allowed("high vegetation")) == {"tree"}  # code 5
    assert names(named, named.allowed("road surface")) == {"paved ground"}
    assert names(named, named.allowed("wire conductor")) == {"wire"}
    for text in ("unclassified", "low noise", "low point (nois"):
        assert not named.allowed(text).any()
    with pytest.raises(DataError, match="class 'lamp' is unknown to the model"):
        named.allowed("lamp")


def test_points_of_objects_and_painted_points(named, tmp_path):
    write_inventory(tmp_path, object_rows())
    with open_corrections(tmp_path) as store:
        store.add(Correction("accept", 1), who="a")
        store.add(Correction("reject", 2), who="a")
        store.add(Correction("other_kind", 3, kind="pole"), who="a")
        for points, name in (([0, 1], "wire"), ([1, 6], "building")):
            store.add(Correction("paint", payload={"file": "a.laz", "points": points, "class": name}), who="a")
        store.add(Correction("paint", payload={"file": "a.laz", "points": [7], "class": "unclassified"}), who="a")
        store.add(Correction("paint", payload={"file": "b.laz", "points": [5], "class": "wire"}), who="a")
        states, table = store.states(), store.objects().table
    objects = object_classes(states, dict(zip(table["object_id"], table["class"], strict=True)), named)
    object_id = np.array([1, 1, 1, 2, 3, 0, 0, 4])
    found = answers_of_file("a.laz", object_id, states, objects, named)
    told = ["" if k < 0 else names(named, found.classes[k]) for k in found.answer]
    assert told[:2] == [{"wire"}, {"building"}]
    assert told[2] == {"pole"} and told[4] == {"pole"} and told[6] == {"building"}
    assert len(told[3]) == 12 and "pole" not in told[3]
    assert told[5] == told[7] == ""
    fewer = answers_of_file("a.laz", object_id[:3], states, objects, named)  # the stroke on point 6 is of another file
    assert [names(named, fewer.classes[k]) for k in fewer.answer] == [{"wire"}, {"wire"}, {"pole"}]
    assert len(unmatched_strokes(states.painted, {"a.laz": 8})) == 1


def test_outputs_that_cannot_learn_are_refused_by_name(tmp_path):
    with pytest.raises(ReadError, match="holds no finished results of label"):
        LabelledOutput.at(tmp_path)
    record = {"summary": {"method": "fusion", "model": {"name": "m", "version": "2"}}}
    with pytest.raises(ParameterError, match="labelled by fusion, which labels through images and cannot learn"):
        check_learnable(LabelledOutput(tmp_path, record))
    (tmp_path / ".mlsroad" / "x").mkdir(parents=True)
    (tmp_path / ".mlsroad" / "x" / "run.json").write_text("{")
    with pytest.raises(ReadError, match=r"run\.json is damaged"):
        LabelledOutput.at(tmp_path)
