"""Data of the benchmark of networks on a GPU: objects, images and superpoints of simulated streets in one NPZ.

`make_data` simulates the streets, in some minutes. `Data` reads the file; it needs neither the simulator nor Kedro.
"""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mlsroad_pipeline.algorithms.models.superpoint_transformer.graph import SuperpointGraph, ranges
from mlsroad_pipeline.algorithms.models.superpoint_transformer.inputs import even_points

TRAIN, TEST = (3001, 3002, 3003, 3004), (4001, 4002)
"""Seeds of the streets."""

LEAST, MOST, EACH = 30, 250, 10
"""Least and most points of an object; least number of training objects of a class."""

IMAGES = 4
"""Images of a street."""

REACH = {TRAIN[0]: 20.0, TEST[0]: 15.0}
"""Radius of the scene whose superpoints are taken, metres."""

POINTS, REPEATED = 6, 24
"""Points stored of a superpoint of level 1, and points that these are repeated to as far as it has so many."""

UNKNOWN = 255

Arrays = dict[str, NDArray[Any]]


def make_data(file: Path) -> None:
    """Simulate the streets and write the file."""
    from forest_trials import configured_scheme  # noqa: PLC0415  the file is read where it has not all it needs

    from mlsroad_pipeline.algorithms.cameras.cityscapes import encode_label_image, image_classes  # noqa: PLC0415
    from mlsroad_pipeline.simulation import PRESETS, simulate_survey  # noqa: PLC0415
    from mlsroad_pipeline.simulation.parameters.street_parameters import STREETS  # noqa: PLC0415

    scheme, found = configured_scheme("tomic2019"), Packed()
    rich = replace(STREETS["town"], people=3.0, two_wheelers=3.0, clutter=2.0, signs=2.0)
    for seed in (*TRAIN, *TEST):
        survey = simulate_survey(replace(PRESETS["small"], seed=seed, street=rich, image_interval=16.0), n_threads=1)
        found.add_objects(survey.cloud, seed)
        for i in np.linspace(0, len(survey.images) - 1, IMAGES).astype(int).tolist():
            image = survey.images[i]
            found.add_image(image.rgb, encode_label_image(image.label, scheme), seed)
        if seed in REACH:
            found.add_graph(survey.cloud, scheme, seed)
        print(f"street {seed}: {len(found.label)} objects, {len(found.pictures)} images", flush=True)
    np.savez_compressed(file, n_pixel_classes=len(image_classes(scheme)), n_classes=len(scheme), **found.to_arrays())
    print(f"{file}: {file.stat().st_size / 2**20:.2f} MiB")


class Packed:
    """Content of the file while it is collected."""

    def __init__(self) -> None:
        self.xyz: list[NDArray[np.float16]] = []
        self.intensity: list[NDArray[np.float16]] = []
        self.label: list[int] = []
        self.street: list[int] = []
        self.pictures: list[bytes] = []
        self.masks: list[bytes] = []
        self.taken: list[int] = []
        self.graphs: Arrays = {}

    def add_objects(self, cloud: Any, seed: int) -> None:
        """Add the instances of a street, subsampled."""
        rng, order = np.random.default_rng(seed), np.argsort(cloud["instance"], kind="stable")
        starts = np.flatnonzero(np.diff(cloud["instance"][order], prepend=-1))
        for rows in np.split(order, starts[1:]):
            if len(rows) < LEAST or not cloud["instance"][rows[0]]:
                continue
            drawn = np.sort(rng.permutation(rows)[:MOST])
            own = cloud.xyz[drawn].astype(np.float64)
            self.xyz.append((own - own.mean(axis=0)).astype(np.float16))
            self.intensity.append(cloud["intensity"][drawn].astype(np.float16))
            self.label.append(int(cloud["label"][drawn[0]]))
            self.street.append(seed)

    def add_image(self, rgb: NDArray[np.uint8], labels: NDArray[np.integer], seed: int) -> None:
        """Add an image as JPEG and its labels plus 1 as PNG."""
        self.pictures.append(encoded(rgb, "JPEG", quality=80))
        self.masks.append(encoded((labels + 1).astype(np.uint8), "PNG"))
        self.taken.append(seed)

    def add_graph(self, cloud: Any, scheme: Any, seed: int) -> None:
        """Add the superpoints of the middle of a street."""
        from forest_trials import configured_stages  # noqa: PLC0415  as above

        from mlsroad_pipeline.algorithms.models.superpoint_transformer.labeller import prepare  # noqa: PLC0415
        from mlsroad_pipeline.algorithms.models.superpoint_transformer.parameters import (  # noqa: PLC0415
            SuperpointTransformerParameters,
        )
        from mlsroad_pipeline.algorithms.models.superpoint_transformer.training_graphs import (  # noqa: PLC0415
            training_graphs,
        )

        stages, p = configured_stages(detrend=False), SuperpointTransformerParameters(augmentation={"cuts": 0})
        middle = np.median(cloud.xyz[:, :2], axis=0)
        scene = cloud.select(np.flatnonzero(np.linalg.norm(cloud.xyz[:, :2] - middle, axis=1) < REACH[seed]))
        graph = training_graphs(scene, *prepare(scene, stages), parameters=p, stages=stages, scheme=scheme)["scanned"]
        graph["points"] = np.minimum(np.diff(graph["indptr"]), REPEATED)
        kept = even_points(SuperpointGraph.from_arrays(graph), POINTS)
        for name, values in graph.items():
            key = f"graph_{seed}.{name}"
            if name in ("offset", "values") or name.endswith(".values"):
                self.graphs |= in_bytes(key, values if "." in name else values[kept])
            elif name not in ("names", "attributes", "indptr"):
                self.graphs[key] = values

    def to_arrays(self) -> Arrays:
        """Return the content as arrays."""
        return {
            "xyz": np.concatenate(self.xyz),
            "intensity": np.concatenate(self.intensity),
            "indptr": np.append(0, np.cumsum([len(points) for points in self.xyz])),
            "label": np.array(self.label),
            "street": np.array(self.street),
            **joined("pictures", self.pictures),
            **joined("masks", self.masks),
            "taken": np.array(self.taken),
            **self.graphs,
        }


def encoded(pixels: NDArray[np.uint8], kind: str, **options: Any) -> bytes:
    """Return an image as the bytes of a file."""
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, kind, **options)
    return out.getvalue()


def joined(name: str, files: list[bytes]) -> Arrays:
    """Return files as one array and where each starts."""
    ends = np.cumsum([len(content) for content in files])
    return {name: np.frombuffer(b"".join(files), np.uint8), f"{name}_indptr": np.append(0, ends)}


def in_bytes(name: str, table: NDArray[np.float32]) -> Arrays:
    """Return a table as one byte per value, with the range of each column."""
    low, high = np.nanmin(table, axis=0), np.nanmax(table, axis=0)
    step = np.maximum(high - low, 1e-9) / (UNKNOWN - 1)
    values = np.where(np.isnan(table), UNKNOWN, np.round((table - low) / step))
    return {name: values.astype(np.uint8), f"{name}@low": low, f"{name}@step": step}


def graph_of(arrays: Arrays) -> SuperpointGraph:
    """Return the superpoints of a street with points repeated to their number there."""
    full = dict(arrays)
    for name, values in arrays.items():
        if f"{name}@low" in arrays:
            known = np.where(values == UNKNOWN, np.nan, values.astype(np.float32))
            full[name] = (arrays[f"{name}@low"] + known * arrays[f"{name}@step"]).astype(np.float32)
    counts = arrays["points"]
    stored = np.minimum(counts, POINTS)
    place = ranges(np.zeros(len(counts), np.int64), counts) % np.repeat(stored, counts)
    rows = np.repeat(np.cumsum(stored) - stored, counts) + place
    full |= {name: full[name][rows] for name in ("offset", "values")}
    return SuperpointGraph.from_arrays({**full, "indptr": np.append(0, np.cumsum(counts))})


class Data:
    """Objects, images and superpoints of streets of training and of other streets.

    Parameters
    ----------
    file : Path
        File of `make_data`.
    tiny : bool
        Take a small part, to test the benchmark.
    """

    def __init__(self, file: Path, *, tiny: bool = False) -> None:
        with np.load(file, allow_pickle=False) as arrays:
            self._arrays, self._tiny = dict(arrays), tiny
        self.n_pixel_classes, self.n_classes = (int(self._arrays[f"n_{name}classes"]) for name in ("pixel_", ""))

    def objects(self, *, test: bool) -> tuple[list[NDArray[Any]], list[NDArray[Any]], NDArray[np.int64]]:
        """Return points, intensities and classes of objects."""
        a = self._arrays
        ours = np.isin(a["street"], TRAIN)
        counts = np.bincount(a["label"][ours], minlength=256)
        kept = np.flatnonzero((ours != test) & (counts[a["label"]] >= EACH))[: 60 if self._tiny else None]
        rows = [slice(a["indptr"][i], a["indptr"][i + 1]) for i in kept]
        xyz, intensity = ([a[name][row].astype(np.float64) for row in rows] for name in ("xyz", "intensity"))
        return xyz, intensity, a["label"][kept].astype(np.int64)

    def images(self, *, test: bool) -> list[tuple[NDArray[np.uint8], NDArray[np.int16]]]:
        """Return images and their labels."""
        kept = np.flatnonzero(np.isin(self._arrays["taken"], TRAIN) != test)[: 2 if self._tiny else None]
        return [(self._file("pictures", i), self._file("masks", i).astype(np.int16) - np.int16(1)) for i in kept]

    def graphs(self, *, test: bool) -> list[SuperpointGraph]:
        """Return the superpoints of streets."""
        found: dict[int, Arrays] = {}
        for name, values in self._arrays.items():
            if name.startswith("graph_"):
                seed, _, key = name.removeprefix("graph_").partition(".")
                found.setdefault(int(seed), {})[key] = values
        return [graph_of(arrays) for seed, arrays in found.items() if (seed in TEST) == test]

    def _file(self, name: str, i: int) -> NDArray[np.uint8]:
        first, last = self._arrays[f"{name}_indptr"][i : i + 2]
        with Image.open(io.BytesIO(self._arrays[name][first:last].tobytes())) as picture:
            return np.array(picture)
