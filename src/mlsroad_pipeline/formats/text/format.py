"""Text: one point per row, with or without header comments and a row of names, plain or gzip-compressed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.point_cloud import PointCloud
from mlsroad_pipeline.formats.base import ReadOptions, WriteOptions
from mlsroad_pipeline.formats.content import output_file, with_packed
from mlsroad_pipeline.formats.crs import write_sidecar
from mlsroad_pipeline.formats.tables import PointTable, TableFormat, parts_of
from mlsroad_pipeline.formats.text.layout import GROWS, open_table
from mlsroad_pipeline.formats.text.values import column_names, parse_rows, write_columns


class TextFormat(TableFormat):
    """Reader and writer of text tables.

    Without a row of names the columns are x, y, z, column_3, column_4 and so on, from 0; colours are detected
    by their values (`text_layout`). Columns of words are left out. All values are float64, but `label` and `instance`
    int32, `rgb` uint8 and `intensity` float32.
    """

    name = "text"
    extensions: tuple[str, ...] = with_packed(".txt", ".xyz", ".csv", ".asc", ".pts", ".xyz_label_conf")
    signatures: tuple[bytes, ...] = ()

    def open_table(self, path: Path, options: ReadOptions) -> PointTable:
        """Open a file; its rows are counted, not parsed."""
        found = open_table(path, options)
        placed = "x" in options.columns
        if found.wrong and not placed:
            raise ReadError(found.wrong)

        def rows(names: Sequence[str], start: int, stop: int) -> Mapping[str, NDArray]:
            data, line = found.rows.read(start, stop), found.rows.first_line + start
            parsed = parse_rows(data, found.form, path=path, first_line=line, threads=options.n_threads > 1)
            columns = dict(zip(found.numeric_names, parsed, strict=True))
            return {name: columns[name] for name in names}

        notes = tuple(note for note in found.notes if not (placed and note == GROWS))
        details = {"delimiter": found.delimiter, "decimal": found.form.decimal, "names": found.names}
        return PointTable(found.numeric_names, found.rows.n_rows, rows, None, details, notes, found.guess)

    def write(self, path: Path, cloud: PointCloud, options: WriteOptions) -> None:
        """Write a cloud as text with a row of names, compressed where the path ends in ``.gz``.

        Floats other than coordinates are written with as many digits as it takes to read them back unchanged.
        """
        path = Path(path)
        with output_file(path) as stream:
            stream.write(column_names(cloud, options))
            for part in parts_of(cloud):
                stream.write(write_columns(part, options))
        write_sidecar(path, cloud.crs)
