"""Files of a delivery: the corrected inventory in all formats, the corrected points, and the protocol."""

from __future__ import annotations

import filecmp
import logging
import os
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from mlsroad_pipeline import __version__
from mlsroad_pipeline.algorithms.core.exceptions import MlsRoadError, ParameterError, ReadError
from mlsroad_pipeline.algorithms.inventory.road.places import MEASURED
from mlsroad_pipeline.execution.run_identity import STATE
from mlsroad_pipeline.formats.files import write_atomic
from mlsroad_pipeline.formats.las.copc import write_copc
from mlsroad_pipeline.inventory_files.exports import EXPORTS
from mlsroad_pipeline.inventory_files.geopackage import check_closed, read_geopackage, write_geopackage
from mlsroad_pipeline.inventory_files.geoparquet import write_geoparquet
from mlsroad_pipeline.inventory_files.opendrive import write_opendrive
from mlsroad_pipeline.inventory_files.own_schema import DRIVERS, read_schema, write_own_schema
from mlsroad_pipeline.inventory_files.road_files import LAYERS, read_road
from mlsroad_pipeline.inventory_files.road_inventory import RoadInventory
from mlsroad_pipeline.inventory_files.vector_files import without_formulas, write_gml
from mlsroad_pipeline.review.compared_entries import COMPARED
from mlsroad_pipeline.review.corrections import Decision, open_corrections
from mlsroad_pipeline.review.corrections.checked_states import checked_tables
from mlsroad_pipeline.review.corrections.labelled_output import LabelledOutput
from mlsroad_pipeline.review.corrections.states import States
from mlsroad_pipeline.review.delivery.catalogue import ITEM, VPC, catalogue_ending, stac, write_catalogue
from mlsroad_pipeline.review.delivery.corrected_objects import corrected_inventory, kinds_of_classes, within_reach
from mlsroad_pipeline.review.delivery.corrected_points import (
    ClassCodes,
    PointChanges,
    painted_points,
    write_corrected_cloud,
)
from mlsroad_pipeline.review.delivery.protocol import decision_table, kind_table, lines_by_kind, protocol_page
from mlsroad_pipeline.review.page_server.output_folder import INVENTORY, OutputFolder

logger = logging.getLogger(__name__)

_EXPORTED = {
    ".csv": "csv", ".geojson": "geojson", ".json": "geojson", ".fgb": "flatgeobuf", ".shp": "shapefile", ".dxf": "dxf",
}  # fmt: skip
_SINGLE = {".gpkg": write_geopackage, ".parquet": write_geoparquet, ".xodr": write_opendrive}
SUFFIXES = (".gpkg", ".parquet", *_EXPORTED, ".gml", ".xodr", ".laz", ".html")
"""Endings of files that are delivered: inventories, points, and the protocol."""

ALL_POINTS = "*.laz"
"""Name of a target for the labelled points of all files, which keep their names below its folder."""


class Delivery:
    """A checked survey to deliver: an output folder of `label` and what of it to write.

    Rejected and merged objects stay with `keep_rejected`; `checked` leaves out objects that nobody looked at, `within`
    those farther from the path in metres. `schema` is a YAML file with layers, fields and codes of inventories.
    """

    def __init__(
        self,
        folder: Path,
        *,
        keep_rejected: bool = False,
        checked: bool = False,
        within: float | None = None,
        schema: Path | None = None,
    ) -> None:
        if not (folder / INVENTORY).is_file():
            raise ReadError(f"{folder} holds no results of label: label the survey first (mlsroad label FILE)")
        found = OutputFolder.find(folder)
        if found is None:
            logger.warning(
                "%s has no record of label in %s: it is not known which classes are objects, nor whether results were "
                "edited; copy the folder with it, or label again",
                *(folder, STATE),
            )
        # An inventory alone, such as that of a copied folder, has no record of its run.
        self.output = found or OutputFolder(folder, {"outputs": (), "summary": {"survey": folder}})
        self._keep, self._checked, self._within = keep_rejected, checked, within
        self._schema = None if schema is None else read_schema(schema)
        self._labelled = LabelledOutput(folder, {"settings": {}, **self.output.run})
        self.kinds = kinds_of_classes(self._labelled.schemes)
        with open_corrections(folder, write=False, create=False) as store:
            self.states: States = store.states()
            self.history: list[Decision] = store.history()

    @cached_property
    def listed(self) -> RoadInventory:
        """Inventory as it was labelled."""
        self._labelled.check_unedited([INVENTORY])
        return read_geopackage(self.output.path / INVENTORY)

    @cached_property
    def corrected(self) -> RoadInventory:
        """Inventory after the decisions."""
        found = corrected_inventory(
            self.listed, self.states, kinds=self.kinds, keep_rejected=self._keep, checked=self._checked
        )
        return found if self._within is None else within_reach(found, self._within)

    @cached_property
    def delivered(self) -> RoadInventory:
        """Inventory after the decisions, with the measures of the road where they are of the same labels."""
        tables, left_out = checked_tables(self.output.path, self.states.checks, ["road"])
        for line in left_out:
            logger.warning("%s; no measures of the road are written", line)
        if not tables:
            return self.corrected
        layers = read_road(self.output.path / "road" / LAYERS)
        rows, shapes, kind = layers["intrusions"]
        checked = tables["road"].loc[tables["road"]["state"] != MEASURED, "checked"].to_numpy()
        kept = (checked != "") if self._checked else np.ones(len(rows), dtype=bool)
        kept &= (checked != "wrong") | self._keep
        layers["intrusions"] = rows.assign(checked=checked)[kept], shapes[kept], kind
        return replace(self.corrected, road=layers)

    def write(self, targets: Sequence[Path], *, overwrite: bool = False) -> list[Path]:
        """Write files and return the paths of all, the targets first.

        The ending of a target is its format; `ALL_POINTS` in a folder are the labelled points of all files. Formats of
        several files write them beside the target. Nothing is written if one of them exists, unless `overwrite` is set.
        """
        for target in targets:
            self._check_target(target)
            if not _is_all(target):
                self._check_free(target, overwrite=overwrite)
        with ExitStack() as stack:
            staged: dict[Path, Path] = {}
            for target in sorted(targets, key=lambda path: bool(catalogue_ending(path))):
                folder = stack.enter_context(tempfile.TemporaryDirectory(dir=_near(target), prefix=".mlsroad-"))
                ending, place = catalogue_ending(target), Path(folder)
                for path, final in self._catalogue(target, place, staged) if ending else self._written(target, place):
                    if final in staged and not filecmp.cmp(path, staged[final], shallow=False):
                        raise ParameterError(f"{final} would be written twice: give the files different names")
                    staged[final] = path
            for final in staged:
                self._check_free(final, overwrite=overwrite)
            for final, path in staged.items():
                final.parent.mkdir(parents=True, exist_ok=True)
                os.replace(path, final)
        return list(staged)

    def _check_target(self, target: Path) -> None:
        if catalogue_ending(target):
            stac()
        elif target.suffix.lower() not in SUFFIXES:
            known = ", ".join((*SUFFIXES, VPC, ITEM))
            raise ParameterError(
                f"{target}: unknown format {target.suffix!r}: the name of a delivered file ends in {known}"
            )
        elif self._schema is not None and target.suffix.lower() in {*SUFFIXES} - {*DRIVERS, ".laz", ".html"}:
            raise ParameterError(f"{target}: a schema of your own is written as {', '.join(DRIVERS)}")
        if _near(target).is_file():
            raise ReadError(f"{_near(target)} is a file, not a folder")
        if not _near(target).is_dir():
            raise ReadError(f"{_near(target)} does not exist: create the folder first")

    def _check_free(self, final: Path, *, overwrite: bool) -> None:
        """Raise ParameterError for a file that must not be replaced."""
        if os.path.realpath(final) in self._kept:
            raise ParameterError(f"{final} is a result of label or a file of the survey: choose another name")
        if final.is_dir():
            raise ParameterError(f"{final} is a folder: name a file")
        if final.suffix.lower() == ".gpkg":
            check_closed(final)
        if os.path.lexists(final) and not overwrite:
            raise ParameterError(f"{final} exists: name another file with -o, or replace it with --overwrite")

    @cached_property
    def _kept(self) -> set[str]:
        """Files that are never replaced: results of label, and its input."""
        run = self.output.run
        results = [str(self.output.path / entry["path"]) for entry in run["outputs"]]
        return {os.path.realpath(path) for path in (*results, *(entry["path"] for entry in run.get("inputs", ())))}

    def _written(self, target: Path, folder: Path) -> list[tuple[Path, Path]]:
        """Write the files of a target into a folder; return each with its place."""
        suffix = target.suffix.lower()
        if suffix == ".laz":
            return self._points(target, folder)
        if suffix == ".html":
            return self._protocol(target, folder)
        own = folder / target.name
        if self._schema is not None:
            written = write_own_schema(self.corrected, self._schema, own)
            return [(path, target.with_name(path.name)) for path in written]
        if suffix in _EXPORTED:
            try:
                written = EXPORTS[_EXPORTED[suffix]].write(self.delivered, folder)
            except MlsRoadError as error:
                wrong = folder / PurePosixPath(EXPORTS[_EXPORTED[suffix]].files[0]).name
                text = str(error).replace(str(wrong), str(target)).replace(str(folder), str(target.parent))
                raise type(error)(text.replace("out of label.export", "out")) from error
            places = [_place(path, target) for path in written]
            return sorted(zip(written, places, strict=True), key=lambda pair: pair[1] != target)
        if suffix == ".gml":
            return [(path, target.with_name(path.name)) for path in write_gml(self.delivered, own)]
        try:
            _SINGLE[suffix](self.delivered, own)
        except MlsRoadError as error:
            raise type(error)(str(error).replace(str(own), str(target))) from error
        return [(own, target)]

    def _points(self, target: Path, folder: Path) -> list[tuple[Path, Path]]:
        clouds = self.output.clouds
        if not _is_all(target) and len(clouds.files) > 1:
            raise ParameterError(
                f"{target}: the survey has {len(clouds.files)} labelled files: name a folder for them, such as "
                f"{target.with_suffix('')}/"
            )
        self._labelled.check_unedited([file.name for file in clouds.files])
        codes = ClassCodes(self.output)
        numbers = self.corrected.objects["object_id"].tolist()
        changes = PointChanges.of(self.listed.objects, self.states, codes, numbers)
        painted = painted_points(clouds, self.states, codes)
        for name in sorted(changes.unknown):
            logger.warning(
                "The labelled points have no code for the class %r: points of such objects keep theirs", name
            )
        pairs = []
        for file in clouds.files:
            own = folder / file.name if _is_all(target) else folder / "points.laz"
            write_corrected_cloud(file, own, changes, painted)
            pairs.append((own, target.parent / file.name if _is_all(target) else target))
        if target.name.lower().endswith(".copc.laz"):
            write_copc(str(pairs[0][0]), str(folder / "points.copc.laz"), n_threads=2)
            return [(folder / "points.copc.laz", target)]
        return pairs

    def _catalogue(self, target: Path, folder: Path, staged: Mapping[Path, Path]) -> list[tuple[Path, Path]]:
        """Write a file of STAC that names the files of the same delivery, and results of label of other formats."""
        new = {final.suffix.lower() for final in staged}
        paths = [self.output.path / str(entry["path"]) for entry in self.output.run["outputs"]]
        results = {path: path for path in paths if path.suffix.lower() not in new - {".html"}}
        if ".laz" not in new:
            self._labelled.clouds()  # an error where one is missing
            if self.history:
                logger.warning("%s names the points as labelled: write the corrected ones with it (-o laz/)", target)
        summary = self.output.run["summary"]
        properties = {f"mlsroad:{key}": summary[key] for key in ("method", "model") if summary.get(key)}
        properties["processing:software"] = {"mlsroad": __version__}
        places = {path: now for path, now in {**results, **staged}.items() if now.is_file()}
        write_catalogue(folder / target.name, target, places, Path(self.output.name).stem, properties)
        return [(folder / target.name, target)]

    def _protocol(self, target: Path, folder: Path) -> list[tuple[Path, Path]]:
        run = self.output.run["summary"]
        model = run.get("model")
        name = model.get("name") if isinstance(model, Mapping) else model
        facts: dict[str, Any] = {"survey": self.output.name, "folder": str(self.output.path.name), "model": name}
        table = kind_table(self.listed.objects, self.states, self.kinds)
        lines = lines_by_kind(self.listed.lines, self.states)
        checked, left_out = checked_tables(self.output.path, self.states.checks)
        for line in left_out:
            logger.warning("%s", line)
        page = folder / "page.html"
        write_atomic(page, protocol_page(facts, self.history, table, lines, checked).encode())
        written = [(page, target)]
        tables = {PurePosixPath(COMPARED[name].file).stem: rows for name, rows in checked.items()}
        for name, rows in {"decisions": decision_table(self.history), **tables}.items():
            own = folder / f"{name}.csv"
            write_atomic(own, without_formulas(rows).to_csv(index=False, lineterminator="\n").encode())
            written.append((own, target.with_name(f"{target.stem}_{name}.csv")))
        return written


def _is_all(target: Path) -> bool:
    """Return whether a target stands for the labelled points of all files, in its folder."""
    return target.name == ALL_POINTS


def _near(target: Path) -> Path:
    """Return an existing folder on the file system of a target."""
    return target.parent.parent if _is_all(target) and not target.parent.is_dir() else target.parent


def _place(written: Path, target: Path) -> Path:
    """Return the place of a file of an export beside its target; the file that programs open is the target."""
    main = EXPORTS[_EXPORTED[target.suffix.lower()]].files[0]
    if written.name == PurePosixPath(main).name:
        return target
    own = "" if written.stem in ("inventory", PurePosixPath(main).stem) else f"_{written.stem}"
    return target.with_name(f"{target.stem}{own}{written.suffix}")
