"""Report of the study of Yu et al. 2016, with the paper's results next to ours."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from mlsroad_pipeline.papers.yu2016.study.figures import CAPTIONS
from mlsroad_pipeline.papers.yu2016.study.plan import StudyPlan
from mlsroad_pipeline.papers.yu2016.study.results import StudyTables
from mlsroad_pipeline.reporting.html.report import FactsSection, FiguresSection, Section, TableSection


def study_sections(plan: StudyPlan, tables: StudyTables, figures: Sequence[Figure]) -> list[Section]:
    """Return the sections of the report."""
    facts = {
        name: f"{', '.join(f'{key} {value}' for key, value in survey.survey.items())}; "
        f"trained on {list(survey.train)}, tested on {list(survey.test)}"
        for name, survey in plan.scale.surveys.items()
    }
    spread = "Over the objects of all test streets; spread is the standard deviation between streets."
    return [
        FactsSection("Runs", facts),
        TableSection("Streets", tables.setup, note="Cars drawn over more than 8 m are left out of the reference."),
        TableSection("Training", tables.training, note="Words of the vocabulary, examples, CPU seconds."),
        FiguresSection("Figures", dict(zip(CAPTIONS.values(), figures, strict=True))),
        TableSection(
            "Segmentation",
            tables.segmentation,
            note="Mean over test streets; touching: instances that touch another one.",
        ),
        TableSection("Table II: objects and detections", tables.table_2, note="Visual words, and the same as printed."),
        TableSection("Table III: recall, precision, quality, F-score", tables.table_3, note=spread),
        TableSection("Table IV: time", tables.table_4, note="CPU seconds; points per second and thread."),
        TableSection("Table V: cars", tables.table_5, note=spread),
        TableSection(
            "Differences from the visual words",
            tables.differences,
            note="F-score of a method minus that of visual_words, paired by street, with 95 % intervals.",
        ),
        TableSection("Figure 12: settings", tables.figure_12),
    ]
