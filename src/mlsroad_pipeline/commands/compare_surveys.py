"""Two surveys of one place for `mlsroad compare`."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError
from mlsroad_pipeline.commands.console import (
    collected_warnings,
    count_table,
    output_console,
    print_warnings,
    shown_path,
)
from mlsroad_pipeline.commands.options import check_exist
from mlsroad_pipeline.commands.session import configure, find_place

if TYPE_CHECKING:
    from mlsroad_pipeline.label.compared_surveys import ComparedSurveys


class SurveyOptions(NamedTuple):
    """Options of a comparison of surveys."""

    align: bool
    surfaces: bool
    overwrite: bool
    verbose: bool


def compare_two_surveys(earlier: str, later: str, target: Path, options: SurveyOptions) -> None:
    """Compare two folders of results, write the changes and print them."""
    check_exist([earlier, later])
    if os.path.realpath(earlier) == os.path.realpath(later):
        raise ParameterError(f"{later} is named twice: name the folders of two surveys")
    configure(find_place())
    from mlsroad_pipeline.algorithms.inventory.changes.surfaces import py4dgeo
    from mlsroad_pipeline.label.change_report import FILES, write_changes
    from mlsroad_pipeline.label.compared_surveys import compare_surveys
    from mlsroad_pipeline.label.labelled_clouds import Recorded
    from mlsroad_pipeline.label.result_files import check_target
    from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput
    from mlsroad_pipeline.review.delivery.files import Delivery

    if any((target / name).exists() for name in FILES) and not options.overwrite:
        raise ParameterError(
            f"{target} holds the changes of two surveys: name another folder with --output, or replace them with "
            "--overwrite"
        )
    outputs = [LabelledOutput.at(folder) for folder in (earlier, later)]
    check_target(target, FILES, ("key", "state", "second_id"), "changes of two surveys", outputs)
    if options.surfaces:
        py4dgeo()
    with collected_warnings(verbose=options.verbose) as logged:
        surveys = [Recorded.of(output, Delivery(output.path).corrected) for output in outputs]
        compared = compare_surveys(*surveys, align=options.align, surfaces=options.surfaces)
        written = write_changes(compared, target, list(logged))
    print_changes(output_console(), compared)
    print_warnings(output_console(), logged)
    for path in written:
        output_console().print(f"  {shown_path(path)}", markup=False)


def print_changes(console: Any, compared: "ComparedSurveys") -> None:
    """Print the number of objects by kind and state, the offset, and the surfaces."""
    from mlsroad_pipeline.algorithms.inventory.changes.lines import STATES as LINE_STATES
    from mlsroad_pipeline.algorithms.inventory.changes.objects import STATES
    from mlsroad_pipeline.label.change_report import offset_text, surface_table
    from mlsroad_pipeline.label.compared_lines import length_table

    rows = [
        (str(kind), *(f"{(part['state'] == state).sum():,}" for state in STATES))
        for kind, part in compared.objects.groupby("kind", sort=True)
    ]
    console.print(count_table(rows, ("kind", *STATES)))
    lengths = length_table(compared.lines.table).set_index("kind")
    if len(lengths):
        rows = [(str(kind), *(f"{row.get(s, 0.0):,.1f}" for s in LINE_STATES)) for kind, row in lengths.iterrows()]
        console.print(count_table(rows, ("line [m]", *LINE_STATES)))
    console.print(f"\nOffset of the later survey: {offset_text(compared)}.", markup=False)
    if compared.surfaces is not None:
        table = surface_table(compared.surfaces)
        rows = [(row["surface"], f"{row['measured']:,}", f"{row['significant']:,}") for row in table.to_dict("records")]
        console.print(count_table(rows, ("surface", "core points", "significant change")))
