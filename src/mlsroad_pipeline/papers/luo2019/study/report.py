"""Report of the study of Luo et al. 2019, with the paper's results next to ours."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from mlsroad_pipeline.papers.luo2019.study.figures import CAPTIONS
from mlsroad_pipeline.papers.luo2019.study.parameters import COMBINED
from mlsroad_pipeline.papers.luo2019.study.plan import StudyPlan
from mlsroad_pipeline.papers.luo2019.study.results import StudyTables
from mlsroad_pipeline.reporting.html.report import FactsSection, FiguresSection, Section, TableSection


def study_sections(plan: StudyPlan, tables: StudyTables, figures: Sequence[Figure]) -> list[Section]:
    """Return the sections of the report."""
    scale = plan.scale
    facts = {
        "scale": plan.study.scale,
        "seeds of the methods": ", ".join(map(str, scale.seeds)),
        **{
            f"{COMBINED}={i}": f"noise, share kept, outliers, occlusion {list(v)}"
            for i, v in enumerate(scale.combined, 1)
        },
        "Figures 7, 13 and 14": f"jointnet with {dict(scale.variants)}" if scale.variants else "jointnet unchanged",
        "Sydney Urban Objects": ", ".join(plan.folds) or "not used",
    }
    means = "Means over classes on undisturbed test objects."
    paired = "Mean F1 of a method minus that of jointnet; 95 % bootstrap intervals of 2,000 samples of test streets."
    times = (
        "CPU time on one thread, batches of 32 objects of 1,000 points. Memory of a training step: weights, gradients, "
        "momenta and tensors stored for the backward pass. The paper's values are of a GPU; its recognition times are "
        "of test sets of about 4,500 and 1,900 objects."
    )
    three = [TableSection("Table 3: Sydney Urban Objects", tables.table_3)] if len(tables.table_3) else []
    tuned = [TableSection("Settings tried on validation objects", tables.tuning)] if len(tables.tuning) else []
    return [
        FactsSection("Runs", facts),
        FiguresSection("Figures", dict(zip(CAPTIONS.values(), figures, strict=True))),
        TableSection("Table 2: methods", tables.table_2, note=means),
        *three,
        TableSection("Differences from JointNet", tables.differences, note=paired),
        TableSection("Table 1: sub-networks", tables.table_1, note=times),
        TableSection("Table 4: efficiency", tables.table_4, note=times),
        TableSection("Figure 7: image sizes", tables.image_sizes),
        TableSection("Combinations of image sizes", tables.size_grid),
        TableSection("Figure 12: disturbed test objects", tables.robustness),
        TableSection("Figures 13 and 14: disturbed training objects", tables.training),
        *tuned,
    ]
