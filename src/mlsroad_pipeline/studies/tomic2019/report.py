"""The report of the study of Tomic et al. 2019, the paper's figures beside ours."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from mlsroad_pipeline.reporting.html.report import FactsSection, FiguresSection, Section, TableSection
from mlsroad_pipeline.studies.tomic2019.plan import StudyPlan
from mlsroad_pipeline.studies.tomic2019.results import StudyTables

CAPTIONS = {
    "f1": "F1 of the classes on test set 2, mean and spread over the surveys",
    "figure_10": "Figure 10: method 1 as printed on test set 1 of the first survey, from above",
    "figure_11": "Figure 11: the piece of a facade that method 1 takes most for something else",
    "figure_12": "Figure 12: an image, its classes, and what its camera says of test set 1",
    "figure_13": "Figure 13: test set 2 of the first survey, from above",
}
"""Name of a figure to what stands below it."""


def study_sections(plan: StudyPlan, tables: StudyTables, figures: Sequence[Figure]) -> list[Section]:
    """Put the study together for a report."""
    scale, division = plan.study.chosen_scale(), plan.division
    facts = {
        "scale": plan.study.scale,
        "surveys": f"{len(scale.seeds)} of {division.length:g} m, seeds {list(scale.seeds)}",
        "division": "half to train method 1 on, a quarter test set 1, a quarter test set 2, "
        f"{division.gap:g} m of road left out between them",
        "images that the network learns from": f"streets of seeds {list(scale.photograph_seeds)}",
    }
    spread = "Mean over the surveys and its standard deviation; paper_ is what the paper prints, of a real street."
    numbered = {
        "Table 1: IoU of segmented images": (tables.table_1, "Paper: Cityscapes, means over its classes."),
        "Table 2: F1 on test set 1": (tables.table_2, "prefer_images: surveys on which the images are better."),
        "Table 3: method 1 on test set 2": (tables.table_3, spread),
        "Table 4: images on test set 2": (tables.table_4, spread + " Unseen points are wrong."),
        "Table 5: fusions on test set 2": (tables.table_5, spread),
        "Overall": (tables.overall, "fusion_by_f1 compares F1 of the two labels alone; see docs/methods/fusion.md."),
        "Gains": (tables.gains, "Errors of a fusion by those of the better method alone, and what its mean F1 gains."),
        "Cameras: F1 on test set 1": (tables.cameras, ""),
        "Redundancy": (tables.redundancy, "Labellers are method 1 and three cameras."),
        "Forests": (tables.forests, ""),
    }
    return [
        FactsSection("What was run", facts),
        FiguresSection("Figures", dict(zip(CAPTIONS.values(), figures, strict=True))),
        *(TableSection(title, table.round(3), note=note) for title, (table, note) in numbered.items()),
    ]
