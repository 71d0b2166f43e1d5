"""Quality report of a file, as a table row and as warnings."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

STANDARD_COLUMNS = ("rgb", "intensity", "gps_time", "scanner", "label", "instance")
"""Columns that a report lists as present or missing."""

HEADINGS = {
    **{"source": "file", "n_points": "points", "n_not_finite": "coordinates not finite"},
    **{"n_duplicates": "repeated points", "duplicates_exact": "repeated points are exact"},
    **{"n_withheld": "flagged withheld", "n_noise": "class of noise (7, 18)", "n_places": "places over 500 m apart"},
    **{"density": "points per m², mean", "median_density": "points per m², median"},
    "concentration": "nearness to one centre (single scan: below 0.45)",
    **{f"{end}_{axis}": f"{axis} {word} [m]" for axis in "xyz" for end, word in (("min", "from"), ("max", "to"))},
    **{"has_rgb": "colour", "has_intensity": "intensity", "has_gps_time": "times", "has_scanner": "scanner"},
    **{"has_label": "classes", "has_instance": "objects", "time_start": "first time [s]", "time_end": "last time [s]"},
    **{"n_gaps": "gaps in time", "longest_gap": "longest gap [s]", "max_gap": "a gap begins at [s]"},
    **{"n_backward": "steps back in time", "n_times_not_finite": "times not finite"},
    **{"intensity_min": "least intensity", "intensity_max": "largest intensity"},
}
"""Headings of the columns of `QualityReport.as_row` in a report."""


@dataclass(frozen=True)
class QualityReport:
    """Quality report of a file."""

    source: str  # The file
    # n_points, n_not_finite: numbers of points and of points with a NaN or infinite coordinate
    n_points: int
    n_not_finite: int
    # Number of exact duplicates; an estimate if `duplicates_exact` is False, at least the number within chunks
    n_duplicates: int
    duplicates_exact: bool  # Whether `n_duplicates` is exact: the file is one chunk or fits into the sketch
    n_withheld: int  # Number of points flagged withheld (LAS)
    n_noise: int  # Number of other points with a code of noise (LAS)
    n_places: int  # Number of places that lie more than 500 m apart
    # low, high: world extent, metres; NaN without finite points
    low: tuple[float, ...]
    high: tuple[float, ...]
    density: float  # Mean and median of the points per square metre in occupied cells of 1 m; NaN without finite points
    # Mean and median of the points per square metre in occupied cells of 1 m; NaN without finite points
    median_density: float
    concentration: float  # How closely the points lie about one place, see `DensityFigures`; NaN without finite points
    # present, missing: `STANDARD_COLUMNS` that all chunks have, and the others
    present: tuple[str, ...]
    missing: tuple[str, ...]
    # Number of points per taxonomy class, ``unknown_<code>`` for other codes; empty without labels
    classes: dict[str, int]
    # time_start, time_end: first and last gps_time, seconds; NaN without times
    time_start: float
    time_end: float
    n_gaps: int  # Number of gaps in time longer than `max_gap`, independent of the order of the points
    longest_gap: float  # Longest gap, seconds; 0 without gaps, NaN without times
    n_backward: int  # Number of stored points with a smaller time than their predecessor
    n_times_not_finite: int  # Number of NaN or infinite times
    # intensity_min, intensity_max: range of the intensity; NaN without intensity
    intensity_min: float
    intensity_max: float
    max_gap: float  # Largest step in time that is not a gap, seconds

    def as_row(self) -> dict[str, str | int | float | bool]:
        """Return the report as a flat row with ``min_x`` to ``max_z``, ``has_<column>`` and ``class_<name>``."""
        row: dict[str, str | int | float | bool] = {
            name: getattr(self, name)
            for name in (
                *("source", "n_points", "n_not_finite", "n_duplicates", "duplicates_exact", "n_withheld"),
                *("n_noise", "n_places", "density"),
                "median_density",
                "concentration",
            )
        }
        for axis, low, high in zip("xyz", self.low, self.high, strict=True):
            row[f"min_{axis}"], row[f"max_{axis}"] = low, high
        row |= {f"has_{name}": name in self.present for name in STANDARD_COLUMNS}
        row |= {
            name: getattr(self, name)
            for name in (
                *("time_start", "time_end", "n_gaps", "longest_gap", "n_backward", "n_times_not_finite"),
                *("intensity_min", "intensity_max", "max_gap"),
            )
        }
        return row | {f"class_{name}": count for name, count in self.classes.items()}

    @classmethod
    def from_row(cls, row: Mapping[str, Any]) -> Self:
        """Return the report that `as_row` made a row of."""
        present = tuple(name for name in STANDARD_COLUMNS if row[f"has_{name}"])
        return cls(
            **{name: row[name] for name in cls.__dataclass_fields__ if name in row},
            low=tuple(float(row[f"min_{axis}"]) for axis in "xyz"),
            high=tuple(float(row[f"max_{axis}"]) for axis in "xyz"),
            present=present,
            missing=tuple(name for name in STANDARD_COLUMNS if name not in present),
            classes={name.removeprefix("class_"): int(row[name]) for name in row if name.startswith("class_")},
        )

    def warnings(self) -> list[str]:
        """Return one sentence per problem of the file."""
        about = "" if self.duplicates_exact else "about "
        absent = [name for name in self.missing if name not in ("scanner", "label", "instance")]
        unknown = sorted(name for name in self.classes if name.startswith("unknown_"))
        problems = (
            (self.n_points == 0, "no points"),
            (bool(absent), f"no column {', '.join(absent)}: features that need them are not computed"),
            (
                self.n_withheld > 0,
                f"{self.n_withheld} points are flagged withheld: not used; they keep their class, with confidence 0",
            ),
            (
                self.n_noise > 0,
                f"{self.n_noise} points have a class of noise (7, 18): not used; they keep it, with confidence 0",
            ),
            (self.n_places > 1, f"the points lie in {self.n_places} places more than 500 m apart"),
            (self.n_not_finite > 0, f"{self.n_not_finite} points with NaN or infinite coordinates"),
            (self.n_duplicates > 0, f"{about}{self.n_duplicates} points repeat another exactly"),
            (
                self.n_gaps > 0,
                f"{self.n_gaps} gaps in gps_time over {self.max_gap:g} s, up to {self.longest_gap:.3g} s",
            ),
            (self.n_backward > 0, f"gps_time steps back {self.n_backward} times"),
            (self.n_times_not_finite > 0, f"{self.n_times_not_finite} points with NaN or infinite gps_time"),
            (bool(unknown), f"label codes outside the taxonomy: {', '.join(unknown)}"),
        )
        return [f"{self.source}: {text}" for applies, text in problems if applies]
