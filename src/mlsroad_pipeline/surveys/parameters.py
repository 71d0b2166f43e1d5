"""What a run is told of its survey: the one that methods are compared on, or the one that is labelled."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mlsroad_pipeline.algorithms.core.classes import Coding
from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.formats.options import TAXONOMY_CODING, ReadOptions


@dataclass(frozen=True)
class SurveyParameters:
    """The survey of a comparison.

    Parameters
    ----------
    root : str
        Its folder.
    splits : mapping
        Split name to a glob, a list of globs, or ``{files, along, sectors, gap}``; None leaves out a split that the
        base configuration has.
    scheme : str
        Class scheme that methods are trained on.
    evaluation_scheme : str, optional
        Coarser class scheme that they are scored on; None takes `scheme`.
    coding : str, default "taxonomy"
        What the label codes of the files mean.
    trajectory : str, optional
        Name of the trajectory's file in the folder of the points.
    read : mapping
        Arguments of `ReadOptions`.
    source : str, optional
        Where the survey is to be had, which is said where `root` is no folder.

    Raises
    ------
    ParameterError
        If the name of a split is not made of letters, digits, `_` and `-`.
    """

    root: str
    splits: Mapping[str, Any]
    scheme: str
    evaluation_scheme: str | None = None
    coding: str = "taxonomy"
    trajectory: str | None = None
    read: Mapping[str, Any] = field(default_factory=dict)
    source: str | None = None

    def __post_init__(self) -> None:
        for name in self.splits:
            if re.fullmatch(r"[A-Za-z0-9_-]+", str(name)) is None:
                raise ParameterError(f"a split is named by letters, digits, '_' and '-', got {name!r}")

    def check_root(self) -> None:
        """Make sure that the survey is there.

        Raises
        ------
        ReadError
            If its root is not a folder; the message says where the survey is to be had, where that is known.
        """
        if not Path(str(self.root)).is_dir():
            where = f"; it is to be had from {self.source}" if self.source else ""
            raise ReadError(f"{self.root} is not a folder (survey.root){where}")

    def options(self, codings: Mapping[str, Mapping[int, str] | None]) -> ReadOptions:
        """Return how the files are read.

        Raises
        ------
        ParameterError
            If the coding is not in the configuration or an option is wrong.
        """
        if self.coding not in codings:
            raise ParameterError(f"survey.coding {self.coding!r} is not configured (codings: {', '.join(codings)})")
        codes = codings[self.coding]
        coding = TAXONOMY_CODING if codes is None else Coding(self.coding, {int(k): v for k, v in codes.items()})
        return ReadOptions.from_config({**self.read, "coding": coding})


@dataclass(frozen=True)
class LabelParameters:
    """A survey to label, and what becomes of it.

    Parameters
    ----------
    survey : str
        A file, a folder or a glob.
    output : str
        The folder for the results; not a folder of the survey.
    method : str, default "detrended_forest"
        The slug of the method whose model is used.
    model : int or str, optional
        A version of the model; None takes the highest.
    scheme : str, default "asprs"
        Codes that are written: ``"asprs"``, or a class scheme that the model's classes nest in, as codes from 64.
    trajectory : str, optional
        Name of the trajectory's file in the folder of the points.
    read : mapping
        Arguments of `ReadOptions`.
    inventory : mapping
        Changes of the rules that make objects, by kind or class.
    copc : bool, default False
        Whether a cloud-optimised copy (``.copc.laz``), which web viewers and QGIS stream, is written beside each LAZ.
    coloured_ply : bool, default False
        Whether a PLY in the colours of the classes, for viewers that know none, is written beside each LAZ.
    images : str or None, default "calibration.json"
        Name of the file of cameras in the folder of the points, or its path, for methods that look at images; see
        `camera_files.read_images`. None means a survey without images.

    Raises
    ------
    ParameterError
        If `model` is no version.
    """

    survey: str
    output: str
    method: str = "detrended_forest"
    model: int | str | None = None
    scheme: str = "asprs"
    trajectory: str | None = "trajectory.csv"
    read: Mapping[str, Any] = field(default_factory=dict)
    inventory: Mapping[str, Any] = field(default_factory=dict)
    copc: bool = False
    coloured_ply: bool = False
    images: str | None = "calibration.json"

    def __post_init__(self) -> None:
        if self.model is not None and re.fullmatch(r"[1-9]\d*", str(self.model)) is None:
            raise ParameterError(
                f"label.model must be a version such as 3, or null for the highest; got {self.model!r}"
            )
