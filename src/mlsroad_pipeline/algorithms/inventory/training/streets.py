"""Streets on which the object classifier is trained: simulated, labelled by a model, and disturbed.

On recordings a model is wrong more often than on simulated streets, and poles lean more. Disturbed streets have both:
the logarithms of the class probabilities get normal noise per class, for the street as a whole and for cubes of 3 m,
and are flattened; some poles are labelled tree and some trunks pole; the street is sheared, and single poles lean and
are smeared. The strength of the noise of a street is drawn around the one at which the mean IoU on eight common classes
falls to that of recordings that the model did not learn from (docs/results.md): for `pool`, strength 1.25 lowered it
from 0.81 to 0.61 on 24 streets without leaning and confused poles. On Oakland poles lean and are labelled tree.
"""

import zlib
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.classes import TAXONOMY, TAXONOMY_NAMES, ClassScheme
from mlsroad_pipeline.algorithms.inventory.objects.class_groups import ClassEvidence, evidence_of_labels, group_shares
from mlsroad_pipeline.algorithms.inventory.objects.rules import KIND_OF_CLASS

LEAST_POINTS = {"pole": 20, "sign": 10, "vehicle": 50, "tree": 100}
"""Minimum points of a true object that counts, by kind."""

CLEAN, LABELS, DISTURBED, CUT = "clean", "labels", ("disturbed_1", "disturbed_2"), "cut"
"""Variants of a street: as labelled; with classes and confidences alone; disturbed; with gaps that cut vehicles."""

RECORDED = "recorded"
"""Variant of the vehicles of a recording, whose boxes are known."""

PERIOD, GAP = (8.0, 16.0), (0.2, 0.5)
"""Of the gaps: distance of their middles, metres, and width as a share of it."""

NOISE, FLATNESS, CUBE = 0.7, 0.3, 3.0
"""Standard deviations of the noise of log probabilities and of the logarithm of their factor; edge of the cubes, m."""

STRENGTH = (0.4, 1.8)
"""Range of the strength of the noise of a street, a factor of `NOISE` and `FLATNESS`."""

SHEAR = 0.035
"""Standard deviation of the shear along each axis, metres per metre of height: 2 degrees."""

LEAN, SMEAR, POST_RADIUS = 0.03, 0.4, 0.4
"""Of single poles and posts: standard deviation of their lean along each axis, and of the logarithm of the factor, at
least 1, of their distance from their axis, as where passes do not fit together; radius within which points are smeared,
metres. Recorded poles lean by up to 6 degrees, simulated ones hardly."""

CONFUSED = 0.4
"""Share of the poles that a model labels tree, of the trunks that it labels pole, and of the signs that it labels as
what they hang on: on Oakland thick wooden poles, and plates on masts, facades and before trees."""

HOLDERS, GROUNDS = ("pole", "tree", "building"), ("paved ground", "natural ground")
DOUBT, DECOY, DECOYS = (0.7, 2.5), 1.0, 0.003
"""Range of the difference of logarithms between the holder's probability and that of a confused sign; edge of the cubes
of other things that are taken for signs, m, and their share."""

SIGNS = [TAXONOMY[name] for name, kind in KIND_OF_CLASS.items() if kind == "sign"]
TRUE_KINDS = {name: kind for name, kind in KIND_OF_CLASS.items() if name != "cycas"}  # low vegetation of the scheme


class Street(NamedTuple):
    """A labelled street."""

    name: str
    local: NDArray[np.float64]  # Points
    origin: NDArray[np.float64]  # Of their coordinates
    height: NDArray[np.float64]  # Above the ground, m
    evidence: ClassEvidence  # Class probabilities
    truth: NDArray[np.integer]  # True class of each point, a code of the taxonomy
    instance: NDArray[np.integer]  # True object of each point
    objects: pd.DataFrame  # True objects
    scheme: ClassScheme  # Classes of the probabilities


def variants_of(number: int) -> tuple[str, ...]:
    """Return the variants of a street that are used, by its number."""
    return (CLEAN, *DISTURBED, CUT, LABELS) if number % 4 == 0 else (CLEAN, *DISTURBED, CUT)


def variant_of_street(
    name: str,
    variant: str,
    points: Mapping[str, NDArray],
    objects: pd.DataFrame,
    labels: Mapping[str, NDArray],
    scheme: ClassScheme,
) -> Street:
    """Return a variant of a simulated street, with the class probabilities and heights that a model gave it."""
    probabilities, owner = labels["probabilities"].astype(np.float32), labels["owner"].astype(np.int64)
    if variant == LABELS:
        best, sure = np.append(probabilities.argmax(axis=1), -1), np.append(probabilities.max(axis=1), 0.0)
        evidence = evidence_of_labels(best[owner], sure[owner], scheme)
    else:
        evidence = ClassEvidence(probabilities, owner, group_shares(scheme))
    known = np.isfinite(labels["height"])
    evidence = ClassEvidence(evidence.probabilities, np.where(known, evidence.owner, -1), evidence.groups)
    street = Street(
        name, points["xyz"].astype(np.float64), points["origin"].astype(np.float64),
        np.where(known, labels["height"], 0.0).astype(np.float64), evidence, points["truth"], points["instance"],
        objects, scheme,
    )  # fmt: skip
    if variant == CUT:
        return with_gaps(street, seed_of(name, variant))
    return disturb(street, seed_of(name, variant)) if variant in DISTURBED else street


def seed_of(name: str, variant: str) -> int:
    """Return the seed of a variant of a street."""
    return zlib.crc32(f"{name} {variant}".encode())


def with_gaps(street: Street, seed: int) -> Street:
    """Return a street without the points between parallel upright planes, as behind obstacles and at its ends."""
    rng = np.random.default_rng(seed)
    turn, period, share, start = rng.uniform(0.0, np.pi), rng.uniform(*PERIOD), rng.uniform(*GAP), rng.uniform()
    across = street.local[:, 0] * np.cos(turn) + street.local[:, 1] * np.sin(turn)
    rows = np.flatnonzero((across / period + start) % 1.0 >= share)
    known = street.evidence
    evidence = ClassEvidence(known.probabilities, known.owner[rows], known.groups)
    return street._replace(
        local=street.local[rows], height=street.height[rows], evidence=evidence, truth=street.truth[rows],
        instance=street.instance[rows],
    )  # fmt: skip


def disturb(street: Street, seed: int) -> Street:
    """Return a street with noise of a random strength in its class probabilities, and sheared."""
    rng = np.random.default_rng(seed)
    strength = rng.uniform(*STRENGTH)
    owner, probabilities = street.evidence.owner, street.evidence.probabilities
    known, n, n_classes = owner >= 0, len(probabilities), probabilities.shape[1]
    size = np.maximum(np.bincount(owner[known], minlength=n), 1)
    totals = [np.bincount(owner[known], weights=street.local[known, k], minlength=n) for k in range(3)]
    middle = np.stack(totals, axis=1) / size[:, None]
    cube = np.unique(np.floor(middle / CUBE).astype(np.int64), axis=0, return_inverse=True)[1].ravel()
    logits = np.log(probabilities.astype(np.float64) + 1e-3) * np.exp(-abs(rng.normal(0.0, FLATNESS * strength)))
    logits += rng.normal(0.0, NOISE * strength, n_classes)
    logits += rng.normal(0.0, NOISE * strength, (int(cube.max()) + 1, n_classes))[cube]
    logits = confuse_signs(street, confuse_poles(street, logits, rng), middle, rng)
    disturbed = np.exp(logits - logits.max(axis=1, keepdims=True))
    disturbed /= disturbed.sum(axis=1, keepdims=True)
    local = lean_poles(street, rng)
    local[:, :2] += street.height[:, None] * rng.normal(0.0, SHEAR, 2)
    return street._replace(
        local=local, evidence=ClassEvidence(disturbed.astype(np.float32), owner, street.evidence.groups)
    )


def confuse_poles(street: Street, logits: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Return logarithms of class probabilities with tree and pole exchanged for some poles and some trunks."""
    kind = street.objects["label"].map(lambda code: TRUE_KINDS.get(TAXONOMY_NAMES[code]))
    drawn = kind.isin(["pole", "tree"]).to_numpy() & (rng.random(len(kind)) < CONFUSED)
    poles, trees = (set(street.objects["instance"][drawn & (kind == k).to_numpy()]) for k in ("pole", "tree"))
    changed = np.isin(street.instance, list(poles))
    changed |= np.isin(street.instance, list(trees)) & (street.truth == TAXONOMY["trunk"])
    rows = np.unique(street.evidence.owner[changed & (street.evidence.owner >= 0)])
    tree, pole = street.scheme.classes.index("tree"), street.scheme.classes.index("pole")
    out = logits.copy()
    out[rows, tree], out[rows, pole] = logits[rows, pole], logits[rows, tree]
    return out


def confuse_signs(
    street: Street, logits: NDArray[np.float64], middle: NDArray[np.float64], rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return logarithms of class probabilities with some signs taken for what they hang on, and decoys of signs.

    A confused sign is less probable than a pole, tree or building; in cubes of other things it is about as probable.
    """
    owner, out = street.evidence.owner, logits.copy()
    sign = street.scheme.classes.index("sign")
    on_sign = np.isin(street.truth, SIGNS) & (owner >= 0)
    is_sign = np.bincount(owner[on_sign], minlength=len(logits)) > 0
    for number in np.unique(street.instance[on_sign]):
        if rng.random() < CONFUSED:
            rows = np.unique(owner[on_sign & (street.instance == number)])
            other = street.scheme.classes.index(str(rng.choice(HOLDERS)))
            out[rows, other] = logits[rows].max(axis=1)
            out[rows, sign] = out[rows, other] - rng.uniform(*DOUBT)
    cube = np.unique(np.floor(middle / DECOY).astype(np.int64), axis=0, return_inverse=True)[1].ravel()
    drawn, doubt = rng.random(int(cube.max()) + 1) < DECOYS, rng.uniform(*DOUBT, int(cube.max()) + 1)
    ground = np.isin(np.argmax(logits, axis=1), [street.scheme.classes.index(name) for name in GROUNDS])
    rows = np.flatnonzero(drawn[cube] & ~is_sign & ~ground)
    out[rows, sign] = np.maximum(out[rows, sign], out[rows].max(axis=1) - doubt[cube[rows]])
    return out


def lean_poles(street: Street, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return the points of a street with poles and posts that lean about their foot and are smeared."""
    table = street.objects
    upright = table["label"].map(lambda code: TRUE_KINDS.get(TAXONOMY_NAMES[code])).isin(["pole", "sign"])
    known = np.zeros(int(max(table["instance"].max(), street.instance.max())) + 1, np.int64)
    known[table["instance"][upright]] = np.arange(1, int(upright.sum()) + 1)
    number = known[np.maximum(street.instance, 0)]
    local, rows = street.local.copy(), np.flatnonzero(number)
    own = number[rows] - 1
    foot = table.loc[upright, ["x", "y"]].to_numpy() - street.origin[:2]
    lean = rng.normal(0.0, LEAN, (len(foot), 2))
    factor = np.exp(np.abs(rng.normal(0.0, SMEAR, len(foot))))
    near = np.hypot(*(local[rows, :2] - foot[own]).T) < POST_RADIUS
    off = local[rows, :2] - foot[own]
    off *= np.where(near, factor[own], 1.0)[:, None]
    local[rows, :2] = foot[own] + off + street.height[rows, None] * lean[own]
    return local


def true_objects(street: Street) -> pd.DataFrame:
    """Return the true objects of the kinds with their places, and whether they count: not moving, enough points.

    `enough` is true for moving ones with enough points too. A plate on a mast of another kind is a sign of its own.
    """
    table, most = street.objects, int(street.objects["instance"].max()) + 1
    number = np.maximum(street.instance, 0)
    counts, on_plates = (np.bincount(rows, minlength=most) for rows in (number, number[np.isin(street.truth, SIGNS)]))
    kind = table["label"].map(lambda code: TRUE_KINDS.get(TAXONOMY_NAMES[code]))
    held = (table["panel_x"].notna() & kind.notna() & (kind != "sign")).to_numpy()
    own = table[kind.notna().to_numpy()].assign(kind=kind, n_points=lambda t: counts[t["instance"]])
    plates = table[held].assign(kind="sign", n_points=lambda t: on_plates[t["instance"]])
    found = pd.concat([own, plates], ignore_index=True)
    vehicle, panel = found["kind"] == "vehicle", (found["kind"] == "sign") & found["panel_x"].notna()
    enough = found["n_points"] >= found["kind"].map(LEAST_POINTS)
    return pd.DataFrame({
        "kind": found["kind"],
        "x": found["x"].where(~vehicle, found["box_x"]).where(~panel, found["panel_x"]),
        "y": found["y"].where(~vehicle, found["box_y"]).where(~panel, found["panel_y"]),
        "counted": enough & ~found["moving"].astype(bool), "instance": found["instance"], "length": found["length"],
        "enough": enough,
    })  # fmt: skip
