"""What the pipelines say about themselves: tags by stage, layers by folder."""

from kedro.framework.project import configure_project, pipelines

from mlsroad_pipeline.config import with_layers
from mlsroad_pipeline.pipelines.composition import comparison


def test_each_node_of_the_default_is_tagged_with_a_pipeline_that_has_it():
    configure_project("mlsroad_pipeline")
    holders = {name: {node.name for node in pipelines[name].nodes} for name in comparison()}
    for node in pipelines["__default__"].nodes:
        assert node.tags and all(node.name in holders[tag] for tag in node.tags), node.name
    assert set().union(*(node.tags for node in pipelines["__default__"].nodes)) >= set(comparison()) - {"simulate"}


def test_layers_come_from_paths_and_leave_other_entries_alone():
    entries = {
        "a": {"filepath": "data/04_feature/oakland/a"},
        "b": {"filepath": "/elsewhere/data/04_feature/b"},
        "c": {"type": "kedro.io.MemoryDataset"},
        "d": {"filepath": "data/08_reporting/d.csv", "metadata": {"own": 1}},
        "_anchor": "text",
    }
    found = with_layers(entries)
    assert found["a"]["metadata"] == {"kedro-viz": {"layer": "04_feature"}}
    assert all(found[name] == entries[name] for name in "bcd") and found["_anchor"] == "text"
