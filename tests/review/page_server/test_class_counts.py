"""Counts of the classes in force: those of the files after painted points and objects of another class."""

import numpy as np
import pytest
from helpers.page_output import FILES, write_output

from mlsroad_pipeline.review.corrections import Correction, open_corrections
from mlsroad_pipeline.review.page_server.output_folder import OutputFolder
from mlsroad_pipeline.review.page_server.served_survey import ServedSurvey
from mlsroad_pipeline.review.page_server.tile_building import build_tiles
from mlsroad_pipeline.review.page_server.tile_format import TileIndex

N_POINTS = 68_000
TREE = 64_000  # first row of the tree, object 4


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    folder = tmp_path_factory.mktemp("counts") / "out"
    _, codes = write_output(folder)
    output = OutputFolder.find(folder)
    build_tiles(output.clouds, ServedSurvey(output, user="ann").tiles.folder)
    return folder, codes


def decided(survey, *corrections):
    """Return the counts that a new server states after decisions, and the codes as labelled."""
    folder, codes = survey
    with open_corrections(folder) as store:
        for decision in store.current():
            store.undo(decision.identifier, who="test")
        store.add_all(list(corrections), who="ann")
    server = ServedSurvey(OutputFolder.find(folder), user="ann")
    found = server.corrections(points=False)
    server.close()
    return found, codes.copy()


def stroke(name, points, given):
    return Correction("paint", payload={"file": name, "points": points, "class": given, "n_points": N_POINTS})


def expected(codes):
    return {str(code): int(n) for code, n in enumerate(np.bincount(codes)) if n}


def test_painted_points_of_an_earlier_session_are_read_from_their_chunks(survey):
    rows = [0, 49_999, 50_000, 67_999]
    strokes = (stroke(FILES[0], rows, "wire"), stroke(FILES[1], rows[:2], "pole"), stroke(FILES[0], [0], "road"))
    found, codes = decided(survey, *strokes)
    codes[rows], codes[[N_POINTS, N_POINTS + 49_999]], codes[0] = 14, 64, 11
    assert found["counts"] == expected(codes)


def test_an_object_of_another_class_counts_but_for_its_painted_points(survey):
    changed = Correction("other_kind", 4, kind="pole")
    found, codes = decided(survey, changed, stroke(FILES[0], [TREE, TREE + 1, 5], "wire"))
    codes[TREE : TREE + 4000] = 64
    codes[[TREE, TREE + 1, 5]] = 14
    assert found["counts"] == expected(codes) and found["codes"] == {"4": 64}


def test_a_rejected_object_has_points_without_a_class(survey):
    found, codes = decided(survey, Correction("reject", 1), Correction("merge", 2, payload={"objects": [4]}))
    codes[60_000:62_000] = 1
    codes[TREE : TREE + 4000] = 64
    assert found["counts"] == expected(codes) and found["codes"] == {"1": 1, "4": 64}
    assert found["states"]["4"]["merged_into"] == 2


def test_without_decisions_the_counts_are_those_of_the_files(survey):
    found, codes = decided(survey)
    assert found["counts"] == expected(codes) and found["objects"] == []


def test_nodes_of_decided_objects_are_read_once_for_all_of_them(survey, monkeypatch):
    folder, _ = survey
    with open_corrections(folder) as store:
        for decision in store.current():
            store.undo(decision.identifier, who="test")
        store.add_all([Correction("reject", number) for number in (1, 2, 4)], who="ann")
    server, nodes, read = ServedSurvey(OutputFolder.find(folder), user="ann"), [], TileIndex.chunk
    monkeypatch.setattr(TileIndex, "chunk", lambda tiles, node: nodes.append(node) or read(tiles, node))
    assert server.corrections(points=False)["counts"]["1"] == 8000
    assert nodes and len(nodes) == len(set(nodes))
    server.decide({"action": "accept", "object_id": 3})
    assert server.corrections(points=False)["counts"]["1"] == 8000 and len(nodes) == len(set(nodes))
    server.close()
