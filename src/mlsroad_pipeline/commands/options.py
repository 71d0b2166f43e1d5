"""Options that several commands of `mlsroad` share, and the folders that commands write to by default."""

import getpass
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.execution.parameter_checks import PATHS, local_path, with_text_of_paths

SUFFIX = "_mlsroad"
"""Ending of the folder of results beside a survey."""

RECORDS = ".mlsroad"
"""Folder of the records of runs in a folder of results."""

_NEXT = re.compile(r"""[^{\["']*,\s*([A-Za-z_][\w.]*)=""")
"""A value in which a second parameter follows, as in `kedro run --params`; it would be one text."""

Surveys = Annotated[
    list[str],
    typer.Argument(metavar="FILE...", help="Files, folders or globs of point clouds; several form one survey."),
]
Output = Annotated[
    str | None,
    typer.Option("--output", "-o", metavar="FOLDER", help="Folder of the results. Default: FILE_mlsroad beside FILE."),
]
Params = Annotated[
    list[str] | None,
    typer.Option(
        "--params", metavar="KEY=VALUE", help="Change a parameter, such as label.read.delimiter=';'. May be repeated."
    ),
]
Workers = Annotated[
    int | None, typer.Option("--workers", min=1, metavar="N", help="Number of processes. Default: one per core.")
]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print the log, and the traceback of an error.")]


def login_name() -> str:
    """Return the name of the user; "unknown" for a user number without a name."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "unknown"


def expanded(places: Sequence[str]) -> list[str]:
    """Return places as absolute paths; ``~`` is the home folder."""
    if "" in places:
        raise typer.BadParameter("the name of a file or folder is empty: is a variable of the shell unset?")
    return [os.path.abspath(local_path(os.path.expanduser(place), "FILE or FOLDER")) for place in places]


def check_exist(places: Sequence[str]) -> None:
    """Raise ReadError for a path without wildcards that does not exist, before any library is loaded."""
    for place in places:
        if not os.path.lexists(place) and not any(c in place for c in "*?["):
            raise ReadError(f"{place} does not exist")


def literal(path: str) -> str:
    r"""Return a path as the value of a parameter, in which ``${`` begins no interpolation.

    Examples
    --------
    >>> literal("/data/${street}.laz")
    '/data/\\${street}.laz'
    """
    return re.sub(r"(\\*)\$\{", r"\1\1\\${", path)


def survey_of(places: Sequence[str]) -> str | list[str]:
    """Return places as the value of the parameter of a survey."""
    return literal(places[0]) if len(places) == 1 else [literal(place) for place in places]


def default_output(places: Sequence[str]) -> Path:
    """Return the folder of results of a survey.

    That of a file or folder lies beside it: ``street.laz`` and ``street`` have ``street_mlsroad``. That of several
    files or of a glob lies in their common folder and has its name.
    """
    single = Path(places[0])
    if len(places) == 1 and (single.exists() or not any(c in places[0] for c in "*?[")):
        stem = single.name if single.is_dir() else single.name.removesuffix(".gz")
        stem = stem if single.is_dir() else Path(stem).stem.removesuffix(".copc")
        return single.parent / f"{stem or 'survey'}{SUFFIX}"
    folders = [_folder(Path(place)) for place in places]
    common = Path(os.path.commonpath(folders))
    return common / f"{common.name or 'survey'}{SUFFIX}"


def results_folder(place: str) -> str:
    """Return a folder of results of `label`; for a labelled survey the folder that its results have by default."""
    beside = default_output([place])
    return str(beside) if not Path(place, RECORDS).is_dir() and (beside / RECORDS).is_dir() else place


def _folder(place: Path) -> Path:
    magic = next((i for i, part in enumerate(place.parts) if any(c in part for c in "*?[")), None)
    if magic is not None and not place.exists():
        return Path(*place.parts[:magic])
    return place if place.is_dir() else place.parent


def _key_with_value(values: Any) -> str | None:
    """Return a key such as ``a:1``, which YAML reads where the blank after the colon is missing."""
    if isinstance(values, list):
        return next((found for item in values if (found := _key_with_value(item))), None)
    if not isinstance(values, dict):
        return None
    for key, value in values.items():
        if value is None and ":" in str(key):
            return str(key)
        if found := _key_with_value(value):
            return found
    return None


def nested(pairs: Sequence[str], *, given: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Return ``a.b=value`` options as nested parameters; values are read as YAML scalars, as `kedro run` does.

    `given` maps parameters that have another place on the command line to that place.
    """
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException
    from yaml import YAMLError

    for pair in pairs:
        key, sign, value = pair.partition("=")
        if not sign or not all(key.split(".")):
            raise typer.BadParameter(f"{pair!r} must have the form SECTION.KEY=VALUE", param_hint="--params")
        if key not in PATHS and (more := _NEXT.match(value)):
            message = f"{pair!r} has two parameters: give {more[1]} with a --params of its own"
            raise typer.BadParameter(message, param_hint="--params")
        if key in (given or {}):
            raise typer.BadParameter(f"{key} is given as {(given or {})[key]}", param_hint="--params")
        try:
            OmegaConf.from_dotlist([pair])
        except (YAMLError, OmegaConfBaseException) as error:
            reason = " ".join(str(error).split())
            raise typer.BadParameter(f"{pair!r} is not a YAML value: {reason}", param_hint="--params") from error
    values = OmegaConf.to_container(OmegaConf.from_dotlist(list(pairs)), resolve=False)
    assert isinstance(values, dict)
    if joined := _key_with_value(values):
        message = f"{joined!r} needs a blank after its colon, or quotes if it is text"
        raise typer.BadParameter(message, param_hint="--params")
    return with_text_of_paths({str(key): value for key, value in values.items()}, pairs)
