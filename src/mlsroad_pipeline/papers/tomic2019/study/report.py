"""Report of the study of Tomic et al. 2019, with the paper's results next to ours."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from mlsroad_pipeline.papers.tomic2019.study.figures import CAPTIONS
from mlsroad_pipeline.papers.tomic2019.study.plan import StudyPlan
from mlsroad_pipeline.papers.tomic2019.study.results import StudyTables
from mlsroad_pipeline.reporting.html.report import FactsSection, FiguresSection, Section, TableSection


def study_sections(plan: StudyPlan, tables: StudyTables, figures: Sequence[Figure]) -> list[Section]:
    """Return the sections of the report."""
    scale, division = plan.scale, plan.division
    facts = {
        "scale": plan.study.scale,
        "surveys": f"{len(scale.seeds)} of {division.length:g} m, seeds {list(scale.seeds)}",
        "division": "training half of method 1, test set 1 (a quarter), test set 2 (a quarter), "
        f"gaps of {division.gap:g} m",
        "training images of the network": f"streets of seeds {list(scale.photograph_seeds)}",
    }
    spread = "Mean and standard deviation over the surveys; paper_ columns: the paper's values on a real street."
    numbered = {
        "Table 1: IoU of segmented images": (tables.table_1, "Paper: Cityscapes, means over its classes."),
        "Table 2: F1 on test set 1": (tables.table_2, "prefer_images: surveys on which F1 of the images is higher."),
        "Table 3: method 1 on test set 2": (tables.table_3, spread),
        "Table 4: images on test set 2": (tables.table_4, spread + " Unseen points count as errors."),
        "Table 5: fusions on test set 2": (tables.table_5, spread),
        "Overall": (tables.overall, "fusion_by_f1 compares only F1 of the two labels; see docs/methods/fusion.md."),
        "Gains": (tables.gains, "Error of a fusion relative to the better single method, and gain in mean F1 over it."),
        "Cameras: F1 on test set 1": (tables.cameras, ""),
        "Redundancy": (tables.redundancy, "Labellers are method 1 and three cameras."),
        "Forests": (tables.forests, ""),
        "Variants": (
            tables.variants,
            "Method 1 as printed, with the distance of Papon et al. 2013, without detrending, and with regularised "
            "labels; images by a depth buffer and by hidden point removal.",
        ),
    }
    return [
        FactsSection("Runs", facts),
        FiguresSection("Figures", dict(zip(CAPTIONS.values(), figures, strict=True))),
        *(TableSection(title, table.round(3), note=note) for title, (table, note) in numbered.items()),
    ]
