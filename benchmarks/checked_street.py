"""Check of a simulated street through the server of the page by a scripted user: F of the delivered inventory.

    python benchmarks/checked_street.py [--folder FOLDER] [--length 300]

Simulates a street of the town and labels it. The user takes the first object of the list each time, and decides as the
reference does: an object with a true one of its kind within the distance of the scores is accepted, one with a true
one of another kind that no listed object has gets that kind, all others are rejected. Then true objects with at least
100 points that are missing are added, as a user does who goes along the street. Every decision is a request to the
server, followed by the requests that the page makes. Prints F of the inventory before and after (`mlsroad score` of
`mlsroad export`), the decisions, and the seconds of the server per decision. The user makes no mistakes, so F after is
an upper limit; what is left are objects with fewer points, places and duplicates.
"""

from __future__ import annotations

import http.client
import json
import re
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from _common import RESULTS, mlsroad, parser

from mlsroad_pipeline.algorithms.geometry.assignment import assign_one_to_one
from mlsroad_pipeline.algorithms.inventory.scoring.object_scores import REACH
from mlsroad_pipeline.review.corrections.listed_objects import read_objects
from mlsroad_pipeline.surveys.truth_tables import point_counts, read_truth

LEAST, LIST = 100, "/api/queue?number=100"


class Page:
    """Requests to the server of a page, and the seconds that they took."""

    def __init__(self, address: str) -> None:
        match = re.search(r"http://127\.0\.0\.1:(\d+)(/\?token=\S+)", address)
        if match is None:
            raise SystemExit(f"the page did not start: {address!r}")
        self.port, self.cookie = int(match[1]), ""
        self.cookie = self._asked(match[2])[1].partition(";")[0]
        *_, self.queue = map(self.get, ("/api/survey", "/api/corrections", LIST))

    def _asked(self, path: str, body: Any = None) -> tuple[bytes, str]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=120)
        headers = {"Cookie": self.cookie, "Origin": f"http://127.0.0.1:{self.port}", "Content-Type": "application/json"}
        connection.request("POST" if body else "GET", path, body=json.dumps(body) if body else None, headers=headers)
        answer = connection.getresponse()
        content, cookie = answer.read(), answer.getheader("set-cookie", "")
        connection.close()
        if answer.status != 200:
            raise SystemExit(f"{path}: {answer.status} {content.decode()[:200]}")
        return content, cookie

    def get(self, path: str) -> Any:
        """Return the answer to a request."""
        return json.loads(self._asked(path)[0])

    def decide(self, decision: Mapping[str, Any]) -> float:
        """Make a decision and read states and list again, as the page does; return the seconds."""
        start = time.perf_counter()
        self._asked("/api/decide", decision)
        self.get("/api/states")
        self.queue = self.get(LIST)
        return time.perf_counter() - start

    def order(self) -> Iterator[int]:
        """Yield the first object of the list until the list is empty."""
        while self.queue:
            yield int(self.queue[0]["object_id"])


@contextmanager
def opened(folder: Path) -> Iterator[Page]:
    """Serve the page of a folder."""
    code = "import sys; sys.argv[0] = 'mlsroad'; from mlsroad_pipeline.commands.app import main; main()"
    command = [sys.executable, "-u", "-c", code, "open", str(folder), "--no-browser", "--user", "script"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        yield Page(process.stdout.readline() if process.stdout else "")
        process.terminate()


def decisions(folder: Path, street: Path, order: Iterable[int]) -> Iterator[dict[str, Any]]:
    """Yield the decisions of the user."""
    listed, truth = read_objects(folder).table, read_truth(street)
    counts = point_counts(truth, [street / "survey.laz"])
    true = truth.objects.assign(points=LEAST if counts is None else counts)
    right, found = {}, np.zeros(len(true), bool)
    for kind, reach in REACH.items():
        own, same = (np.flatnonzero(table["kind"] == kind) for table in (listed, true))
        places = (table[["x", "y"]].to_numpy(float)[rows] for table, rows in ((listed, own), (true, same)))
        for a, b in zip(*assign_one_to_one(*places, reach), strict=True):
            right[int(listed["object_id"].iloc[own[a]])] = kind
            found[same[b]] = True
    reaches = true["kind"].map(REACH).to_numpy(float)
    rows = {int(row["object_id"]): row for row in listed.to_dict("records")}
    for number in order:
        if number in right:
            yield {"action": "accept", "object_id": number}
            continue
        gap = np.hypot(true["x"] - rows[number]["x"], true["y"] - rows[number]["y"]).to_numpy()
        near = np.flatnonzero(~found & (gap <= reaches))
        if len(near):
            best = near[gap[near].argmin()]
            found[best] = True
            yield {"action": "other_kind", "object_id": number, "kind": str(true["kind"].iloc[best])}
        else:
            yield {"action": "reject", "object_id": number}
    for row in true[~found & (true["points"] >= LEAST)].to_dict("records"):
        yield {"action": "add", "kind": row["kind"], "payload": {axis: float(row[axis]) for axis in "xyz"}}


def scores(inventory: Path, street: Path, folder: Path) -> dict[str, float]:
    """Return F by kind."""
    mlsroad("score", inventory, "--truth", street, "-o", folder, "--overwrite", "--cloud", street / "survey.laz")
    record = json.loads((folder / "object_scores.json").read_text(encoding="utf-8"))
    return {row["kind"]: round(row["f_score"], 3) for row in record["scores"] if row["f_score"] is not None}


def main() -> None:
    """Simulate, label, check, deliver, score."""
    arguments = parser(__doc__)
    arguments.add_argument("--folder", type=Path, default=RESULTS / "checked_street")
    arguments.add_argument("--length", type=int, default=300)
    given = arguments.parse_args()
    street, out = given.folder / "street", given.folder / "out"
    if not (out / "inventory.gpkg").is_file():
        options = ("--preset", "demo", "--length", given.length, "--seed", 58, "--params", "street=town")
        mlsroad("simulate", "-o", street, *options, "--params", "with_images=false")
        mlsroad("label", street, "-o", out)
    (out / "corrections.sqlite").unlink(missing_ok=True)
    with opened(out) as page:
        made = [(one["action"], page.decide(one)) for one in decisions(out, street, page.order())]
    actions, seconds = zip(*made, strict=True)
    corrected = given.folder / "corrected.gpkg"
    mlsroad("export", out, "-o", corrected, "--overwrite")
    result = {
        "length": given.length,
        "decisions": dict(Counter(actions)),
        "seconds": {"median": np.median(seconds), "largest": max(seconds), "at": int(np.argmax(seconds)) + 1},
        "before": scores(out / "inventory.gpkg", street, given.folder / "before"),
        "after": scores(corrected, street, given.folder / "after"),
    }
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
