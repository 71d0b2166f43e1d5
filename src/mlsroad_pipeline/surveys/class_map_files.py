"""Class maps: what class numbers of images or points mean, in shipped tables, configured codings and files of users."""

import csv
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import yaml

from mlsroad_pipeline.algorithms.cameras.legend import Legend
from mlsroad_pipeline.algorithms.core.classes import TAXONOMY_NAMES, ClassScheme
from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.plain_text import shortened

OF_SCHEME = "scheme"
"""Name of the map of a network of this package: the classes of the scheme, then the sky."""
OF_RESULTS = "mlsroad"
"""Name of the map of the results of `label`: LAS codes of the classes of the scheme."""
UNLABELLED, OUTLIER = "unlabelled", "outlier"
"""Classes of the taxonomy of points without a class, and of noise."""


def read_class_map(
    given: str, scheme: ClassScheme, *, option: str = "image_labels.classes", codings: Mapping[str, Any] | None = None
) -> Legend:
    """Return the legend of a shipped class map, a configured coding, a CSV or YAML file, or the scheme itself.

    `option` names the parameter in messages; `codings` are those of the configuration, such as ``semantickitti``.
    """
    if given == OF_SCHEME:
        return Legend.of_scheme(scheme)
    if given == OF_RESULTS:
        own = {0: UNLABELLED, 1: UNLABELLED, 7: OUTLIER, 18: OUTLIER}
        own |= dict(zip(scheme.codes().tolist(), scheme.classes, strict=True))
        return _legend([(code, name, name) for code, name in own.items()], given, scheme)
    folder = files("mlsroad_pipeline.surveys").joinpath("class_maps")
    if given in (codings or {}):
        codes = dict(TAXONOMY_NAMES if (coding := (codings or {})[given]) is None else coding)
        return _legend([(code, name, name) for code, name in codes.items()], given, scheme)
    if "/" not in given and (shipped := folder.joinpath(f"{given}.csv")).is_file():
        return _legend(_csv_rows(shipped.read_text(encoding="utf-8"), given), given, scheme)
    path = Path(given).expanduser()
    if path.suffix.lower() not in (".csv", ".yml", ".yaml"):
        known = sorted(
            {*(codings or {}), *(name.name.removesuffix(".csv") for name in folder.iterdir()), OF_SCHEME, OF_RESULTS}
        )
        raise ReadError(f"{option} is {given!r}: name {', '.join(known)}, or a file .csv or .yml")
    if not path.is_file():
        raise ReadError(f"{path}: no such class map ({option})")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ReadError(f"{path}: cannot be read as a class map: {error}") from error
    rows = _csv_rows(text, str(path)) if path.suffix.lower() == ".csv" else _yaml_rows(text, str(path))
    return _legend(rows, str(path), scheme)


def _legend(rows: list[tuple[Any, Any, Any]], source: str, scheme: ClassScheme) -> Legend:
    checked = []
    for number, name, target in rows:
        try:
            value = int(str(number))
        except ValueError:
            raise ReadError(f"{source}: class number {number!r} is not a whole number") from None
        text = "" if target is None else str(target).strip()
        checked.append((value, str(name or text or value).strip(), text or None))
    legend = Legend.of_rows(checked, source)
    legend.labels(scheme)  # every class is known
    return legend


def _csv_rows(text: str, source: str) -> list[tuple[Any, Any, Any]]:
    table = csv.DictReader(text.splitlines(), skipinitialspace=True)
    columns = [name.strip() for name in table.fieldnames or []]
    for needed in ("number", "class"):
        if needed not in columns:
            raise ReadError(f"{source}: no column {needed!r} among {columns}; a class map has number, name, class")
    table.fieldnames = columns
    rows = []
    for row in table:
        if row["class"] is None or None in row:
            raise ReadError(f"{source}: line {table.line_num} has not the {len(columns)} columns {', '.join(columns)}")
        rows.append((row["number"], row.get("name"), row["class"]))
    return rows


def _yaml_rows(text: str, source: str) -> list[tuple[Any, Any, Any]]:
    try:
        keys, given = _keys_and_content(text)
    except (yaml.YAMLError, ValueError) as error:
        raise ReadError(f"{source}: not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(given, dict):
        raise ReadError(f"{source}: must map class numbers to classes, such as `0: road`, not {shortened(repr(given))}")
    repeated = next((key for k, key in enumerate(keys) if key in keys[:k]), None)
    if repeated is not None:
        raise ReadError(f"{source}: class number {repeated} is repeated")
    rows = []
    for number, value in given.items():
        if isinstance(value, dict) and set(value) <= {"name", "class"}:
            rows.append((number, value.get("name"), value.get("class")))
        elif value is None or isinstance(value, str):
            rows.append((number, value, value))
        else:
            shown = shortened(repr(value))
            raise ReadError(f"{source}: class number {number} has {shown}, not a class or {{name, class}}")
    return rows


def _keys_and_content(text: str) -> tuple[list[Any], Any]:
    """Return the keys of a YAML mapping, of which PyYAML keeps the last of equal ones, and its content."""
    loader = yaml.SafeLoader(text)
    node = loader.get_single_node()
    if not isinstance(node, yaml.MappingNode):
        return [], None if node is None else loader.construct_document(node)
    keys = [loader.construct_object(key) for key, _ in node.value if key.tag != "tag:yaml.org,2002:merge"]
    return keys, loader.construct_document(node)
