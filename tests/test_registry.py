"""Registry of pipelines: names, tags by stage, layers by folder."""

import subprocess
import sys
import textwrap

from kedro.framework.project import configure_project, pipelines

from mlsroad_pipeline.algorithms.models.methods import trained_methods
from mlsroad_pipeline.config import with_layers
from mlsroad_pipeline.pipelines.composition import comparison
from mlsroad_pipeline.pipelines.ingest import create_pipeline as create_ingest
from mlsroad_pipeline.pipelines.label import create_pipeline as create_label


def test_each_node_of_the_default_is_tagged_with_a_pipeline_that_has_it():
    configure_project("mlsroad_pipeline")
    holders = {name: {node.short_name for node in pipelines[name].nodes} for name in comparison()}
    for node in pipelines["__default__"].nodes:
        assert node.tags == {name for name, held in holders.items() if node.short_name in held}, node.name
    assert set().union(*(node.tags for node in pipelines["__default__"].nodes)) >= set(comparison()) - {"simulate"}


def test_namespaces_collapse_the_default_to_its_stages_and_leave_datasets_alone():
    configure_project("mlsroad_pipeline")
    default = pipelines["__default__"]
    assert next(iter(pipelines)) == "__default__"  # Kedro-Viz draws the namespaces of the first pipeline with a node
    groups = {group.name: set(group.dependencies) for group in default.group_nodes_by("namespace")}
    stages = {"survey", "ground_removal", "supervoxelise", "features", "patches", "segmentation"}
    assert set(groups) == stages | {"labelling", "detection", "evaluation"}
    assert {"features", "patches"} <= groups["labelling"] and {"labelling", "detection"} <= groups["evaluation"]
    parts = [pipelines[name] for name in comparison()]
    assert default.datasets() == set().union(*(part.datasets() for part in parts))
    of_one = {node.namespace for node in default.nodes if "patch_svm" in node.tags}
    assert of_one == {"labelling", "labelling.patch_svm"}


def test_a_node_has_one_name_in_all_pipelines():
    configure_project("mlsroad_pipeline")
    names: dict[tuple[str, ...], set[str]] = {}
    for pipeline in pipelines.values():
        for node in pipeline.nodes:
            names.setdefault((node.short_name, *node.outputs), set()).add(node.name)
    assert not {key: found for key, found in names.items() if len(found) > 1}
    assert {node.name for node in pipelines["evaluation"].nodes} <= {
        node.name for node in pipelines["all_methods"].nodes
    }


def test_every_method_has_a_pipeline_of_its_name():
    configure_project("mlsroad_pipeline")
    assert set(trained_methods()) | {"label", "__default__"} <= set(pipelines)
    for slug in trained_methods():
        outputs = pipelines[slug].all_outputs()
        assert {f"{slug}.model", f"{slug}.registered_model"} <= outputs, slug


def test_a_command_imports_the_pipelines_that_it_names_alone():
    script = """
        import sys
        from kedro.framework.project import configure_project, pipelines
        configure_project("mlsroad_pipeline")
        pipelines.set_requested(["label", "hough_forest"])
        print(*pipelines)
        print(*sys.modules)
    """
    command = [sys.executable, "-W", "ignore", "-c", textwrap.dedent(script)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    names, loaded = (line.split() for line in done.stdout.splitlines())
    assert names == ["hough_forest", "label"]
    package = "mlsroad_pipeline"
    assert {f"{package}.pipelines.detectors", f"{package}.papers.yu2016.hough_forest.detector"} <= set(loaded)
    unwanted = (
        "simulation",
        "papers.yu2016.study",
        "pipelines.evaluation",
        "papers.yu2016.object_matching",
        "pipelines.stages",
    )
    assert not [name for name in loaded if name.startswith(tuple(f"{package}.{part}" for part in unwanted))]
    assert "torch" not in loaded


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


def test_label_has_the_ingest_in_a_namespace_with_stores_of_its_own():
    ingest, new = create_ingest(), create_label()
    stores = {"describe_files": "files", "find_corridors": "corridors", "cut_files": "pieces"}
    nodes = {node.name: node for node in new.nodes}
    for name, store in stores.items():
        (own,) = (node for node in ingest.nodes if node.name == name)
        assert nodes[f"label.{name}"].func is own.func
        assert nodes[f"label.{name}"].outputs == [f"label_{store}_store"]
    assert not new.datasets() & {"survey_plan", "survey_files", "corridors", "pieces", "survey_quality"}
