"""Survey that the page shows: the answers to its requests as JSON, and chunks of points."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import ParameterError, ReadError
from mlsroad_pipeline.review.compared_entries import COMPARED, Entry, check_entries, checked_of, compared_entries
from mlsroad_pipeline.review.page_server.output_folder import REPORT, OutputFolder
from mlsroad_pipeline.review.page_server.selection import Near, brushed, cluster
from mlsroad_pipeline.review.page_server.tile_cache import TileCache
from mlsroad_pipeline.review.page_server.tile_format import FirstPicture, first_picture
from mlsroad_pipeline.review.page_server.wanted import only_of, places_of, radius_of
from mlsroad_pipeline.review.painted import Painted

if TYPE_CHECKING:
    from mlsroad_pipeline.review.corrections import Correction, CorrectionStore, Decision
    from mlsroad_pipeline.review.corrections.states import States
    from mlsroad_pipeline.review.page_server.background import Background
    from mlsroad_pipeline.review.page_server.decided import Decided
    from mlsroad_pipeline.review.page_server.point_groups import PointGroups

# The corrections need pandas and SciPy, a second of imports that the first picture does not wait for.


_FIRST_WAIT = 4.0  # longest wait for a browser that draws the first picture, seconds


class ServedSurvey:
    """A survey as the page shows it; its methods are called from several threads."""

    def __init__(self, output: OutputFolder, *, user: str, background: Background | None = None) -> None:
        if not output.clouds.n_points:
            raise ReadError(f"{output.path}: the labelled files hold no points, there is nothing to show")
        self.output, self.user, self.background = output, user, background
        self.tiles = TileCache(output.path, output.cloud_names)
        self._guard, self._reading, self._grouping = threading.Lock(), threading.Lock(), threading.Lock()
        self._viewing = threading.Lock()
        self._first: FirstPicture | None = None
        self._store: CorrectionStore | None = None
        self._objects = ""
        self._groups: PointGroups | None = None
        self._entries: dict[str, list[Entry]] | None = None
        self._decided: Decided | None = None
        self._drawn = threading.Event()  # the browser requests states once it has drawn the first picture

    @property
    def first(self) -> FirstPicture:
        """Sample of the points."""
        with self._reading:
            if self._first is None:
                self._first = self.tiles.kept_picture() or first_picture(self.output.clouds)
            return self._first

    @property
    def store(self) -> CorrectionStore:
        """Decisions of the output folder."""
        from mlsroad_pipeline.review.corrections import open_corrections  # noqa: PLC0415

        with self._guard:
            if self._store is None:
                self._store = open_corrections(self.output.path, write=False)
                self._objects = self._store.objects().digest
            return self._store

    def _check_current(self) -> None:
        """Raise ReadError if the survey has been labelled again: numbers of points and objects are others now."""
        if self.store.objects().digest != self._objects or self.tiles.status()["state"] == "stale":
            raise ReadError("the survey was labelled again since the page was opened: end the page and open it again")

    def prepare(self) -> None:
        """Start to read the sample, to build the tiles and to open the decisions, in a thread."""
        threading.Thread(target=self._prepare, daemon=True).start()

    def _prepare(self) -> None:
        try:
            _ = self.first
            self._drawn.wait(_FIRST_WAIT)  # the picture comes first, also where processors are busy
            self.tiles.keep_picture(self.first)
            self.tiles.start()
            _ = self.store
        except Exception as error:  # such as a full disk; the page shows it
            self.tiles.fail(one_line(error))

    def close(self) -> None:
        """End what was started."""
        self.tiles.stop()
        if self._store is not None:
            self._store.close()

    def survey(self, picture: FirstPicture | None = None) -> dict[str, Any]:
        """Return what does not change while the page is open; `picture` replaces the sample of the points."""
        output = self.output
        self._entries, left_out = compared_entries(output.path)
        return {
            "name": output.name,
            "folder": output.path.name,
            "user": self.user,
            "n_points": output.clouds.n_points,
            "origin": output.clouds.origin.tolist(),
            "files": [[file.name, file.first, file.header.n_points] for file in output.clouds.files],
            "classes": {str(code): name for code, name in sorted(output.class_names().items())},
            "objects": output.objects(),
            "footprints": output.footprints(),
            "path": output.path_vertices(),
            "lines": output.lines(),
            "photos": output.photos(),
            "colours": output.colours(),
            "background": "" if self.background is None else self.background.name,
            "report": (output.path / REPORT).is_file(),
            "warnings": output.run["summary"].get("warnings", []),
            "entries": {name: [entry._asdict() for entry in found] for name, found in self._entries.items()},
            "asked": {name: COMPARED[name].asked for name in self._entries},
            "left_out": left_out,
            "first": (picture or self.first).facts,
        }

    def corrections(self, *, points: bool = True) -> dict[str, Any]:
        """Return the states of the objects and the decisions in force, with the painted points unless left out.

        `objects` are those that decisions changed or made, `codes` the classes of points of objects of another class,
        `counts` the points per class, None while the tiles are not finished.
        """
        self._drawn.set()
        mark, states = self.store.mark(), self.store.states()
        decided, painting = self.decided, self._in_force(states)
        files = {file.name: file for file in self.output.clouds.files} if points else {}
        painted = [
            {
                "id": decision.identifier,
                "class": decision.correction.payload["class"],
                "rows": [file.first + row for row in decision.correction.payload["points"]],
            }
            for decision in states.painted
            if (file := files.get(decision.correction.payload["file"])) is not None
            and decision.correction.paints(file.name, file.header.n_points)
        ]
        lost = {decision.identifier for decision in states.unmatched}
        decisions = [
            {
                "id": decision.identifier,
                "made": decision.made,
                "who": decision.who,
                "action": decision.correction.action,
                "object_id": decision.correction.object_id,
                "what": decision.correction.described,
                "line": decision.correction.payload.get("line"),
                "entry": [decision.correction.payload.get(name) for name in ("table", "entry")],
                "lost": decision.identifier in lost,
            }
            for decision in self.store.current()
        ]
        return {
            "states": decided.states(states),
            "painted": painted,
            "decisions": decisions,
            "objects": decided.objects(states),
            "lines": decided.lines(states),
            "notes": {str(number): note._asdict() for number, note in states.notes.items()},
            "notes_of_added": {str(n): note._asdict() for n, note in states.notes_of_added.items()},
            "codes": {str(n): int(painting.of_objects[n]) for n in np.flatnonzero(painting.of_objects >= 0)},
            "counts": decided.counts(self.tiles.index(), painting),
            "checked": {n: checked_of(n, found, states.checks) for n, found in self._compared().items()},
            "mark": mark,
        }

    def _compared(self) -> dict[str, list[Entry]]:
        """Return the entries of compared tables as the page shows them."""
        if self._entries is None:
            self._entries, _ = compared_entries(self.output.path)
        return self._entries

    @property
    def decided(self) -> Decided:
        """Objects and lines of the inventory after all decisions."""
        from mlsroad_pipeline.review.page_server.decided import Decided  # noqa: PLC0415

        with self._viewing:
            if self._decided is None:
                self._decided = Decided(self.output, self.store.objects())
            return self._decided

    def status(self) -> dict[str, Any]:
        """Return the state of the tiles, and a text that changes with every decision, also of other tabs."""
        self._drawn.set()
        return {**self.tiles.status(), "mark": self.store.mark()}

    def deliver(self, wanted: dict[str, Any]) -> dict[str, Any]:
        """Write files of a delivery into a new folder below the output, and return its name and theirs."""
        from mlsroad_pipeline.review.delivery.page_order import deliver_order  # noqa: PLC0415

        return deliver_order(self.output, wanted)

    def queue(self, number: int) -> list[dict[str, Any]]:
        """Return the objects to look at first."""
        from mlsroad_pipeline.review.corrections import review_order  # noqa: PLC0415

        return review_order(self.store.objects().table, self.store.object_states(), number)

    def point_groups(self, number: int) -> list[dict[str, Any]]:
        """Return the groups of points to look at first; none while the tiles are not finished."""
        if self.tiles.index() is None:
            return []
        self._check_current()
        return [dict(group) for group in self._point_groups().first(number, self._in_force())]

    def _point_groups(self) -> PointGroups:
        """Return the groups of the points, found at the first request."""
        from mlsroad_pipeline.review.page_server.point_groups import PointGroups  # noqa: PLC0415  # SciPy

        index = self.tiles.index()
        if index is None:
            raise ReadError("the points are still being prepared: paint when that is finished")
        with self._grouping:
            if self._groups is None:
                path = np.array(self.output.path_vertices()).reshape(-1, 3) - self.output.clouds.origin
                self._groups = PointGroups(index, names=self.output.class_names(), path=path)
            return self._groups

    def leave_out(self, wanted: dict[str, Any]) -> dict[str, Any]:
        """Leave a group out of the list while the page is open, or take it back."""
        self._point_groups().leave_out(places_of(wanted.get("places"))[0], back=bool(wanted.get("back")))
        return {}

    def group(self, wanted: dict[str, Any]) -> dict[str, Any]:
        """Return the rows of the points of a group."""
        return {"rows": self._selected({**wanted, "group": True}).rows.tolist()}

    def decide(self, wanted: dict[str, Any]) -> dict[str, Any]:
        """Write a decision, or those in `all` together, and return the identifiers; they are on the disk then."""
        from mlsroad_pipeline.review.corrections.decisions import check_values  # noqa: PLC0415

        several = wanted.get("all", [wanted])
        if not isinstance(several, list) or not several or not all(isinstance(one, dict) for one in several):
            raise ParameterError("all must be a list of decisions")
        corrections = [_correction(one) for one in several]
        self._check_current()
        check_entries(corrections, self.output.path)
        for correction in corrections:
            if correction.payload.get("class") is not None:
                check_values(correction, classes=self._class_names)
        return {"ids": self.store.add_all(corrections, who=self.user)}

    @cached_property
    def _class_names(self) -> frozenset[str]:
        """Names of classes that a decision may give: of the model, the files and the inventory."""
        from mlsroad_pipeline.review.corrections.edited_inventory import known_names  # noqa: PLC0415  # GeoPandas

        listed = self.store.objects().table["class"].astype(str)
        return known_names(self.output.path).union(self._codes(), listed)

    def undo(self, wanted: dict[str, Any]) -> dict[str, Any]:
        """Take decisions back."""
        identifiers = wanted.get("ids")
        if not isinstance(identifiers, list) or not all(type(identifier) is int for identifier in identifiers):
            raise ParameterError("ids must be a list of numbers of decisions")
        self.store.undo(*identifiers, who=self.user)
        return {}

    def paint(self, wanted: dict[str, Any]) -> dict[str, Any]:
        """Write the class of the points that a stroke or a click selects; return their rows and classes of before."""
        name = wanted.get("class")
        if name not in self._codes():
            raise ParameterError(f"unknown class {name!r} of the survey")
        found = self._selected(wanted)
        if not len(found.rows):
            return {"ids": [], "rows": [], "before": {}}
        index = self.tiles.index()
        if index is not None:
            self.decided.counted(index).know(found)
        ids = self.store.add_all(self._strokes(found.rows, str(name)), who=self.user)
        counts = np.bincount(found.classes, minlength=256)
        before = {str(code): int(counts[code]) for code in np.flatnonzero(counts)}
        return {"ids": ids, "rows": found.rows.tolist(), "before": before}

    def _selected(self, wanted: dict[str, Any]) -> Near:
        """Return the points that a stroke, a click on a cluster or a group selects."""
        index = self.tiles.index()
        if index is None:
            raise ReadError("the points are still being prepared: paint when that is finished")
        self._check_current()
        places, only, painted = places_of(wanted.get("places")), only_of(wanted.get("only")), self._in_force()
        if not (wanted.get("cluster") or wanted.get("group")):
            return brushed(index, places, radius_of(wanted.get("radius")), only, painted)
        if only is None:
            raise ParameterError("a cluster needs the class of its points (only)")
        if wanted.get("group"):
            return self._point_groups().points(places[0], only, painted)
        return cluster(index, places[0], only, painted)

    def _in_force(self, states: States | None = None) -> Painted:
        """Return the classes that decisions in force give to points."""
        states = self.store.states() if states is None else states
        return self.decided.in_force(states, self._painted(states.painted))

    def _codes(self) -> dict[str, int]:
        """Return the code of each class name, the least where several have the name."""
        return {text: code for code, text in sorted(self.output.class_names().items(), reverse=True)}

    def _painted(self, strokes: Sequence[Decision]) -> Iterator[tuple[NDArray[np.int64], str]]:
        """Yield the rows and the class of strokes in order."""
        files = {file.name: file for file in self.output.clouds.files}
        for decision in strokes:
            given = decision.correction
            file = files.get(given.payload["file"]) if given.action == "paint" else None
            if file is not None and given.paints(file.name, file.header.n_points):
                yield np.asarray(given.payload["points"], dtype=np.int64) + file.first, given.payload["class"]

    def _strokes(self, rows: np.ndarray, name: str) -> list[Correction]:
        """Return one decision per file for painted rows."""
        from mlsroad_pipeline.review.corrections import Correction  # noqa: PLC0415

        corrections = []
        for file in self.output.clouds.files:
            own = rows[(rows >= file.first) & (rows < file.first + file.header.n_points)]
            if len(own):
                points = (own.astype(np.int64) - file.first).tolist()
                payload = {"file": file.name, "points": points, "class": name, "n_points": file.header.n_points}
                corrections.append(Correction("paint", payload=payload))
        return corrections


def _correction(wanted: dict[str, Any]) -> Correction:
    """Return a decision of the page."""
    from mlsroad_pipeline.review.corrections import Correction  # noqa: PLC0415

    given = Correction(
        str(wanted.get("action")), wanted.get("object_id"), wanted.get("kind"), wanted.get("payload") or {}
    )
    if given.action == "paint":
        raise ParameterError("points are painted by a selection")
    return given


def one_line(error: Exception) -> str:
    """Return the message of an error in one line; of the system's errors the file and the reason."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return " ".join(str(error).split()) or type(error).__name__
