"""Report of the study of Luo et al. 2016, with the paper's results next to ours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from mlsroad_pipeline.papers.luo2016.study.figures import CAPTIONS
from mlsroad_pipeline.papers.luo2016.study.paper import CLASSES
from mlsroad_pipeline.papers.luo2016.study.plan import StudyPlan
from mlsroad_pipeline.papers.luo2016.study.results import StudyTables
from mlsroad_pipeline.papers.luo2016.study.scores import MEANS
from mlsroad_pipeline.reporting.html.report import FactsSection, FiguresSection, Section, TableSection

PAPER_ON_PATCH_SIZE = (
    "Paper (diamonds at 0.2 m: its Table III; its curves are not given as numbers): F1 of road, grass, palm tree and "
    "cycas changes slightly. F1 of vehicle falls from 0.85 at 0.20 m to 0.69 at 0.35 m, that of light pole sharply "
    "from 0.30 to 0.35 m. Training time falls with patch size. The paper uses 0.2 m."
)
PAPER_ON_SEARCH_RADIUS = (
    "Paper (diamonds at 1.0 m: its Table III): F1 hardly changes from 0.3 to 1.5 m. The objective falls and training "
    "time rises with the radius. The paper uses 1.0 m."
)


NOTE_ON_TABLE_1 = (
    "Objects with at least 100 points. Touching: a patch of the object is beside a patch of another object; the paper "
    "counts overlapping objects by eye."
)
NOTE_ON_PAIRS = (
    "Mean F1 of the first method minus that of the second, paired by test street, with 95 % intervals; sure: the "
    "interval does not contain 0. The intervals hold for one pair at a time."
)


def wide_table(table: pd.DataFrame, metric: str) -> pd.DataFrame:
    """Return Table III as text: one row per method, "mean (paper)" per class, "± spread" for means over classes."""
    chosen = table[table["metric"] == metric]
    spread = chosen["spread"].where(chosen["class"].isin(MEANS))  # ten columns with spreads do not fit on a page
    rows = zip(chosen["mean"], spread, chosen["paper"], strict=True)
    cells = [_cell(*row) for row in rows]
    wide = chosen.assign(cell=cells).pivot(index="method", columns="class", values="cell")
    order = list(dict.fromkeys(chosen["method"]))
    return wide.reindex(index=order, columns=[*CLASSES, *MEANS]).rename_axis(columns=None).reset_index()


def _cell(mean: float, spread: float, paper: float) -> str:
    ours = "–" if np.isnan(mean) else f"{mean:.3f}" if np.isnan(spread) else f"{mean:.3f} ± {spread:.3f}"
    return f"{ours} ({'–' if np.isnan(paper) else f'{paper:.3f}'})"


def _listed(values: Mapping[str, Any]) -> str:
    """Return names and values as one line, nested ones in brackets."""
    pairs = ((key, f"({_listed(v)})" if isinstance(v, Mapping) else v) for key, v in values.items())
    return ", ".join(f"{key} {value}" for key, value in pairs)


def study_sections(plan: StudyPlan, tables: StudyTables, figures: Sequence[Figure]) -> list[Section]:
    """Return the sections of the report."""
    scale = plan.scale
    facts = {
        "scale": plan.study.scale,
        "streets": _listed(scale.survey),
        "test streets": _listed(scale.test_survey) or "same as training streets",
        **{f"test streets {list(r['test'])}": f"trained on {list(r['train'])}" for r in scale.repetitions},
    }
    note = "Ours ± standard deviation over test streets (paper in brackets). "
    note += "The paper swaps the names of precision and recall; here both have their usual meaning."
    return [
        FactsSection("Runs", facts),
        TableSection("Table I: points and objects of all streets", tables.table_1.round(4), note=NOTE_ON_TABLE_1),
        *(
            TableSection(f"Table III: {name}", wide_table(tables.table_3, metric), note=note)
            for name, metric in (("F1", "f1"), ("precision", "precision"), ("recall", "recall"))
        ),
        TableSection(
            "Differences from label transfer with refinement",
            tables.differences.round(3),
            note="Mean F1 of a method minus that of patch_graph_mrf, with 95 % intervals of the paired differences.",
        ),
        TableSection("Differences of every two methods", tables.pairs.round(3), note=NOTE_ON_PAIRS),
        FiguresSection("Figures", dict(zip(CAPTIONS.values(), figures, strict=True))),
        TableSection("Patch size", tables.patch_size.round(3), note=PAPER_ON_PATCH_SIZE),
        TableSection("Local search radius", tables.search_radius.round(3), note=PAPER_ON_SEARCH_RADIUS),
        TableSection("Times", tables.times, note="CPU seconds here; hours on the paper's computer."),
        TableSection("Settings tried on training streets", tables.tuning),
    ]
