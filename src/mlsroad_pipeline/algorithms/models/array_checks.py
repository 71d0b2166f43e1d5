"""Checks of the arrays of a stored model, before kernels without tests of bounds use them."""

from collections.abc import Callable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError
from mlsroad_pipeline.algorithms.models.machines.boosted_trees import BoostedTrees

KINDS = "biufU"
LARGEST_SEARCH = 1e9
"""Limit of the parameters of a search: more would not end."""

Arrays = Mapping[str, NDArray]


def check_model_arrays(arrays: Arrays) -> None:
    """Check the arrays of a model: finite numbers, and indices that stay inside the arrays they index."""
    for name, values in arrays.items():
        _check(values.dtype.kind in KINDS, name, f"holds values of type {values.dtype}")
        if values.dtype.kind == "f":
            _check(bool(_usable(name, values).all()), name, "holds NaN or infinity")
    for mark, check in _FAMILIES.items():
        for prefix in _prefixes(arrays, mark):
            _run(check, arrays, prefix)


def _usable(name: str, values: NDArray) -> NDArray[np.bool_]:
    """Return which numbers a model may hold in an array."""
    if name.endswith(("threshold", "thresholds")):  # an infinite one separates NaN from the rest
        return np.asarray(~np.isnan(values))
    if name.endswith(("normals", "/typical")):  # too few neighbours for a normal; a measure of no false candidate
        return np.asarray(~np.isinf(values))
    return np.isfinite(values)


def _run(check: Callable[[Arrays, str], None], arrays: Arrays, prefix: str) -> None:
    try:
        check(arrays, prefix)
    except KeyError as error:
        raise DataError(f"the model is damaged: it lacks the array {error}") from None
    except (IndexError, TypeError) as error:
        raise DataError(f"the model is damaged: arrays {prefix}*: {error}") from error


def _prefixes(arrays: Arrays, mark: str) -> Iterator[str]:
    """Yield what stands before a name, for each array with that name: nothing, a variant, or a member."""
    for name in arrays:
        if name == mark or name.endswith((f".{mark}", f"/{mark}")) or (mark[0] == "_" and name.endswith(mark)):
            yield name.removesuffix(mark)


def _check(holds: bool, name: str, what: str) -> None:
    if not holds:
        raise DataError(f"the model is damaged: array {name!r} {what}")


def _shaped(arrays: Arrays, name: str, shape: tuple[int | None, ...], kinds: str = "f") -> NDArray:
    values = arrays[name]
    fits = values.ndim == len(shape) and all(n in (None, m) for n, m in zip(shape, values.shape, strict=True))
    wanted = tuple("any" if n is None else n for n in shape)
    _check(fits and values.dtype.kind in kinds, name, f"is {values.dtype} {values.shape}, not {kinds} {wanted}")
    return values


def _indices(arrays: Arrays, name: str, shape: tuple[int | None, ...], low: int, stop: int) -> NDArray:
    values = _shaped(arrays, name, shape, "iu")
    inside = not values.size or bool(low <= values.min() and values.max() < stop)
    _check(inside, name, f"has indices outside {low} to {stop - 1}")
    return values


def _starts(arrays: Arrays, name: str, length: int | None, end: int) -> NDArray:
    """Check the first indices of consecutive parts, and that of the end."""
    values = _shaped(arrays, name, (length,), "iu")
    good = (
        len(values) > 0 and values[0] == 0 and values[-1] == end and bool((np.diff(values.astype(np.int64)) >= 0).all())
    )
    _check(good, name, f"does not ascend from 0 to {end}")
    return values


def _patch_graph(arrays: Arrays, p: str) -> None:
    n, width = _shaped(arrays, f"{p}table", (None, None)).shape
    n_cells = len(_indices(arrays, f"{p}near", (None, None, 2), 0, n + 1))
    _indices(arrays, f"{p}far", (n_cells, None, 2), 0, n + 1)
    scenes = _starts(arrays, f"{p}scene_starts", None, n)
    for name, low, stop in (
        ("scene", 0, len(scenes) - 1),
        ("cell", 0, n_cells),
        ("by_height", 0, n),
        ("rows", 0, 2**62),
    ):
        _indices(arrays, p + name, (n,), low, stop)
    _indices(arrays, f"{p}matches", (n, None), 0, n)
    _indices(arrays, f"{p}members", (n,), 0, n)
    _starts(arrays, f"{p}cell_starts", len(_shaped(arrays, f"{p}centres", (None, width))) + 1, n)
    _shaped(arrays, f"{p}xyz", (n, 3))
    _shaped(arrays, f"{p}heights", (n,))
    n_classes = int(_indices(arrays, f"{p}n_classes", (), 1, 256))
    _indices(arrays, f"{p}labels", (n,), 0, n_classes)
    weights = _shaped(arrays, f"{p}weights", (None,))
    _check(bool((np.abs(weights) < LARGEST_SEARCH).all()), f"{p}weights", f"exceeds {LARGEST_SEARCH:g}")
    search = _shaped(arrays, f"{p}search", (None,))
    _check(
        bool(((search >= 0) & (search <= LARGEST_SEARCH)).all()), f"{p}search", f"is not within 0 to {LARGEST_SEARCH:g}"
    )


def _hough_forest(arrays: Arrays, p: str) -> None:
    feature = _indices(arrays, f"{p}feature", (None,), -1, 2**15)
    m, (leaves, classes) = len(feature), _shaped(arrays, f"{p}shares", (None, None)).shape
    roots = _starts(arrays, f"{p}roots", None, m)
    leaf_roots = _starts(arrays, f"{p}leaf_roots", len(roots), leaves)
    _starts(arrays, f"{p}vote_starts", leaves * classes + 1, len(_shaped(arrays, f"{p}votes", (None, 2))))
    _shaped(arrays, f"{p}threshold", (m,))
    left = _indices(arrays, f"{p}left", (m,), 0, m)
    sizes = np.diff(roots)
    own = np.arange(m) - np.repeat(roots[:-1], sizes)
    inside = (left > own) & (left + 1 < np.repeat(sizes, sizes))  # later nodes alone: no cycles
    known = left < np.repeat(np.diff(leaf_roots), sizes)
    _check(bool(np.where(feature < 0, known, inside).all()), f"{p}left", "points outside its tree")
    cells = _shaped(arrays, f"{p}cells", (2,))
    _check(bool((cells > 1e-3).all()), f"{p}cells", "has cells below 1 mm")
    reach = np.abs(arrays[f"{p}votes"]).max(initial=0.0)
    _check(bool(reach < 1e3), f"{p}votes", "has votes farther than 1 km")


def _markov_trees(arrays: Arrays, p: str) -> None:
    column = _indices(arrays, f"{p}_column", (None,), -1, 2**15)
    m = len(column)
    roots = _starts(arrays, f"{p}_roots", None, m)
    _shaped(arrays, f"{p}_threshold", (m,))
    _shaped(arrays, f"{p}_value", (m, None))
    child = _indices(arrays, f"{p}_child", (m, 2), -1, max(m, 1))
    sizes = np.diff(roots)
    own = (np.arange(m) - np.repeat(roots[:-1], sizes))[:, None]
    inside = ((child > own) & (child < np.repeat(sizes, sizes)[:, None])).all(axis=1)
    _check(bool((inside | (column < 0)).all()), f"{p}_child", "points outside its tree")


def _kernel_machine(arrays: Arrays, p: str) -> None:
    v, d = _shaped(arrays, f"{p}vectors", (None, None)).shape
    counts = _indices(arrays, f"{p}n_vectors", (None,), 0, v + 1)
    t = len(counts)
    _check(int(counts.sum()) == v, f"{p}n_vectors", f"does not add up to {v}")
    _shaped(arrays, f"{p}coefficients", (t - 1, v))
    _shaped(arrays, f"{p}intercepts", (t * (t - 1) // 2,))
    _shaped(arrays, f"{p}sigmoids", (t * (t - 1) // 2, 2))
    _shaped(arrays, f"{p}shift", (d,))
    _check(bool((_shaped(arrays, f"{p}scale", (d,)) > 0).all()), f"{p}scale", "is not positive")
    _check(bool(_shaped(arrays, f"{p}gamma", ()) > 0), f"{p}gamma", "is not positive")


def _bags_of_words(arrays: Arrays, p: str) -> None:
    indices = _shaped(arrays, f"{p}indices", (None,), "iu")
    _starts(arrays, f"{p}indptr", None, len(indices))
    _shaped(arrays, f"{p}data", (len(indices),))
    start = p[: p.index("queries.")] if "queries." in p else p
    words = len(_shaped(arrays, f"{start}inverse_frequency", (None,)))
    _indices(arrays, f"{p}indices", (None,), 0, words)


def _parts_of_objects(arrays: Arrays, p: str) -> None:
    kinds = _shaped(arrays, f"{p}kinds", (None,), "iu")
    _indices(arrays, f"{p}kinds", (None,), 0, len(_shaped(arrays, f"{p}thresholds", (None,))))
    objects = _indices(arrays, f"{p}objects", (None,), 0, len(kinds))
    _check(bool((np.diff(objects.astype(np.int64)) >= 0).all()), f"{p}objects", "does not ascend")


def _boosted_trees(arrays: Arrays, p: str) -> None:
    for name in (f"{p}{own}" for own in ("groups", "offsets", "temperature")):
        _check(name not in arrays or bool(arrays[name].size), name, "is empty")
    BoostedTrees.from_arrays({name.removeprefix(p): values for name, values in arrays.items() if name.startswith(p)})


_FAMILIES: dict[str, Callable[[Arrays, str], None]] = {
    "by_height": _patch_graph,
    "vote_starts": _hough_forest,
    "_child": _markov_trees,
    "n_vectors": _kernel_machine,
    "indptr": _bags_of_words,
    "kinds": _parts_of_objects,
    "n_leaves": _boosted_trees,
}
"""Name of an array to the check of the arrays that stand beside it. Forests check their own."""
