"""Pipeline of `label`: the ingest in a namespace, then a trained model."""

from kedro.pipeline import Pipeline

from mlsroad_pipeline.label.result_warnings import facts_of_pieces
from mlsroad_pipeline.pipelines.ingest import cut_survey
from mlsroad_pipeline.pipelines.label import nodes
from mlsroad_pipeline.pipelines.per_scene import named_node

_CUT = {
    "survey_files": "label_files_store",
    "corridors": "label_corridors_store",
    "pieces": "label_pieces_store",
    "survey_quality": "label_read_quality",
}
"""Outputs of the ingest to their entries in the catalog."""

_ENTRIES = {
    "plan": "label_plan", "run": "label_run", "files": _CUT["survey_files"], "corridors": _CUT["corridors"],
    "pieces": _CUT["pieces"], "read_quality": _CUT["survey_quality"], "quality": "label_quality",
    "checked": "label_quality", "facts": "label_facts", "request": "label_model_request", "model": "label_model",
    "survey_warnings": "label_warnings", "offsets": "label_offsets", "images": "label_images",
    "results": "label_results_store", "joined": "label_objects_store", "written": "label_written_store",
    "inventory": "label_found_inventory", "pictures": "label_pictures", "exports": "label_exports",
    "parameters": "params:label", "ingest": "params:ingest",
    "ground": "params:ground_removal", "classes": "params:classes", "image_labels": "params:image_labels",
}  # fmt: skip
"""Argument of a node function to its entry in the catalog."""

_INVENTORY_FILES = ("label_inventory", "label_inventory_table")
"""Entries of the files with the inventory; the nodes below take it from memory."""


def create_pipeline(**_: object) -> Pipeline:
    """Return the pipeline from a survey to a labelled survey, an inventory and a report."""
    cut = Pipeline(
        cut_survey(),
        namespace="label",
        inputs={"survey_plan": "label_plan"},
        outputs=_CUT,
        parameters={"params:ingest"},
    )
    return Pipeline(
        [
            named_node(nodes.plan_label_files, "label_plan", **_ENTRIES),
            cut,
            named_node(nodes.check_label_outputs, "label_quality", **_ENTRIES),
            named_node(nodes.find_named_model, "label_model_request", **_ENTRIES),
            named_node(facts_of_pieces, "label_facts", "describe_survey", **_ENTRIES),
            named_node(nodes.compare_passes, "label_offsets", **_ENTRIES),
            named_node(nodes.load_model, "label_model", **_ENTRIES),
            named_node(nodes.warn_of_survey, "label_warnings", **_ENTRIES),
            named_node(nodes.find_label_images, "label_images", **_ENTRIES),
            named_node(nodes.label_new_scenes, "label_results_store", **_ENTRIES),
            named_node(nodes.join_label_objects, "label_objects_store", **_ENTRIES),
            named_node(nodes.make_inventory, [_ENTRIES["inventory"], *_INVENTORY_FILES], **_ENTRIES),
            named_node(nodes.draw_pictures, "label_pictures", **_ENTRIES),
            named_node(nodes.write_labelled_files, "label_written_store", **_ENTRIES),
            named_node(nodes.export_label_inventory, "label_exports", "export_inventory", **_ENTRIES),
            named_node(nodes.write_report, ["label_report", "label_summary"], "write_label_report", **_ENTRIES),
        ]
    )
