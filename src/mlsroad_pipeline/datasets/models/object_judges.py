"""The shipped judge of the inventory's objects."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

import numpy as np

from mlsroad_pipeline.algorithms.core.exceptions import ReadError
from mlsroad_pipeline.algorithms.core.plain_text import printable
from mlsroad_pipeline.algorithms.models.object_judge import ObjectJudge
from mlsroad_pipeline.formats.files import WRONG
from mlsroad_pipeline.formats.npz import DAMAGE, MANGLED

FOLDER = Path(__file__).parent / "shipped_judges"
"""Folder of the judge in the package."""

JUDGE, CARD = "judge.npz", "card.md"


@cache
def judge_digest() -> str:
    """Return the SHA256 of the judge's file, which identifies results that depend on it.

    Returns
    -------
    str
        64 hexadecimal digits.

    Raises
    ------
    ReadError
        If the file is missing.
    """
    path = FOLDER / JUDGE
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise ReadError(f"{path} cannot be read ({error}): install the package again") from error


@cache
def shipped_judge() -> ObjectJudge:
    """Return the judge of the package.

    Returns
    -------
    ObjectJudge
        The judge.

    Raises
    ------
    ReadError
        If the file is missing or damaged.
    """
    path = FOLDER / JUDGE
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
            return ObjectJudge.from_arrays(dict(arrays))
    except (*DAMAGE, *MANGLED, *WRONG) as error:
        raise ReadError(f"{path} cannot be read ({printable(error)}): install the package again") from error
