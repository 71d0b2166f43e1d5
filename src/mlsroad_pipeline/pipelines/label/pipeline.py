"""Pipeline of `label`: the ingest in a namespace, then a trained model."""

from kedro.pipeline import Node, Pipeline

from mlsroad_pipeline.pipelines.ingest import cut_survey
from mlsroad_pipeline.pipelines.label.nodes import (
    check_label_outputs,
    describe_survey,
    export_label_inventory,
    find_label_images,
    find_named_model,
    join_label_objects,
    label_new_scenes,
    load_model,
    make_inventory,
    plan_label_files,
    warn_of_survey,
    write_labelled_files,
    write_report,
)


def _ingest() -> Pipeline:
    """Return the pipeline that plans the results, cuts the survey and checks that the results can be written."""
    plan = Node(plan_label_files, ["params:label", "params:ingest", "label_run"], "label_plan", name="plan_label_files")
    cut = Pipeline(
        cut_survey(),
        namespace="label",
        inputs={"survey_plan": "label_plan"},
        outputs={
            "survey_files": "label_files_store",
            "corridors": "label_corridors_store",
            "pieces": "label_pieces_store",
            "survey_quality": "label_read_quality",
        },
        parameters={"params:ingest"},
    )
    check = Node(
        check_label_outputs,
        ["label_plan", "label_files_store", "label_read_quality", "params:label"],
        "label_quality",
        name="check_label_outputs",
    )
    return Pipeline([plan, cut, check])


def _model() -> list[Node]:
    """Return the nodes that choose the model and find the images that it needs."""
    return [
        Node(
            find_named_model,
            ["params:label", "params:image_labels", "params:classes"],
            "label_model_request",
            name="find_named_model",
        ),
        Node(
            describe_survey,
            ["label_plan", "label_pieces_store", "params:ingest"],
            "label_facts",
            name="describe_survey",
        ),
        Node(load_model, ["label_model_request", "label_quality"], "label_model", name="load_model"),
        Node(
            warn_of_survey,
            [
                "label_plan",
                "label_files_store",
                "label_corridors_store",
                "label_quality",
                "label_model",
                "params:label",
                "label_facts",
            ],
            "label_warnings",
            name="warn_of_survey",
        ),
        Node(
            find_label_images,
            ["label_plan", "label_model", "params:label", "params:image_labels"],
            "label_images",
            name="find_label_images",
        ),
    ]


def _labelling() -> list[Node]:
    """Return the nodes that label the scenes, join their objects and write the labelled files."""
    return [
        Node(
            label_new_scenes,
            [
                "label_plan",
                "label_pieces_store",
                "label_corridors_store",
                "label_model",
                "label_images",
                "params:label",
                "params:ingest",
                "params:ground_removal",
                "params:classes",
            ],
            "label_results_store",
            name="label_new_scenes",
        ),
        Node(
            join_label_objects,
            ["label_plan", "label_corridors_store", "label_results_store", "label_model", "params:label"],
            "label_objects_store",
            name="join_label_objects",
        ),
        Node(
            write_labelled_files,
            [
                "label_plan",
                "label_pieces_store",
                "label_results_store",
                "label_objects_store",
                "label_model",
                "params:label",
                "params:classes",
                "label_run",
            ],
            "label_written_store",
            name="write_labelled_files",
        ),
    ]


def _reporting() -> list[Node]:
    """Return the nodes that write the inventory, its copies and the report."""
    return [
        Node(
            make_inventory,
            [
                "label_plan",
                "label_files_store",
                "label_corridors_store",
                "label_objects_store",
                "params:label",
                "label_run",
            ],
            ["label_inventory", "label_inventory_table"],
            name="make_inventory",
        ),
        Node(
            export_label_inventory,
            ["label_plan", "label_inventory", "params:label", "label_run"],
            "label_exports",
            name="export_inventory",
        ),
        Node(
            write_report,
            [
                "label_quality",
                "label_results_store",
                "label_written_store",
                "label_inventory",
                "label_exports",
                "label_model",
                "params:label",
                "label_warnings",
                "label_facts",
            ],
            ["label_report", "label_summary"],
            name="write_label_report",
        ),
    ]


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline from a survey to a labelled survey, an inventory and a report."""
    return Pipeline([_ingest(), *_model(), *_labelling(), *_reporting()])
