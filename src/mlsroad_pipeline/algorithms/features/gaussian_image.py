"""Extended Gaussian images and their alignment about the vertical (Horn 1984)."""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from mlsroad_pipeline.algorithms.core.exceptions import DataError, ParameterError
from mlsroad_pipeline.algorithms.core.validation import check_at_least

UPRIGHT = 0.05
"""Horizontal length of a unit normal below which its azimuth is undefined (3 degrees)."""


def compute_gaussian_images(
    normals: ArrayLike, indptr: ArrayLike, *, n_azimuths: int = 36, n_bands: int = 5
) -> NDArray[np.float32]:
    """Compute extended Gaussian images: histograms of the normals of objects over cells of the sphere.

    The cells have equal areas: bands of equal height in |nz|, divided by azimuth. The sign of a normal is unknown: half
    of its weight goes to its own azimuth, half to the opposite one.
    """
    if n_azimuths < 2 or n_azimuths % 2:
        raise ParameterError(f"n_azimuths must be an even number > 1, got {n_azimuths!r}")
    check_at_least(n_bands, 1, "n_bands")
    axes, starts = np.asarray(normals, dtype=np.float64), np.asarray(indptr, dtype=np.int64)
    if axes.ndim != 2 or axes.shape[1] != 3:
        raise DataError(f"normals must have shape (n, 3), got {axes.shape}")
    if len(starts) < 1 or starts[0] != 0 or starts[-1] != len(axes) or (np.diff(starts) < 0).any():
        raise DataError(f"indptr must rise from 0 to the {len(axes)} normals")
    out = np.zeros((len(starts) - 1, n_bands, n_azimuths), np.float32)
    _count(np.ascontiguousarray(axes), starts, out)
    return out


def align_gaussian_images(images: ArrayLike, references: ArrayLike) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return the rotation about the vertical that maximises the correlation of each image with each reference.

    The correlation over all rotations is computed by Fourier transforms along the azimuth.
    """
    ours, theirs = np.asarray(images, dtype=np.float64), np.asarray(references, dtype=np.float64)
    if ours.ndim != 3 or theirs.ndim != 3 or ours.shape[1:] != theirs.shape[1:]:
        raise DataError(f"images of shapes {ours.shape} and {theirs.shape} cannot be aligned")
    n = ours.shape[2]
    spectra, conjugates = np.fft.rfft(ours, axis=2), np.fft.rfft(theirs, axis=2).conj()
    correlation = np.fft.irfft(np.einsum("mbf,rbf->mrf", spectra, conjugates), n=n, axis=2)[..., : n // 2]
    turns = correlation.argmax(axis=2).astype(np.int32)
    length = np.sqrt((ours**2).sum(axis=(1, 2)))[:, None] * np.sqrt((theirs**2).sum(axis=(1, 2)))[None]
    best = correlation.max(axis=2)
    similarity = np.divide(best, length, out=np.zeros_like(best), where=length > 0)
    return turns, np.clip(similarity, 0.0, 1.0).astype(np.float32)


@njit(cache=True, nogil=True)
def _count(normals: NDArray[np.float64], indptr: NDArray[np.int64], out: NDArray[np.float32]) -> None:
    n_bands, n = out.shape[1], out.shape[2]
    image = np.zeros((n_bands, n))
    for m in range(len(indptr) - 1):
        image[:] = 0.0
        total = 0.0
        for i in range(indptr[m], indptr[m + 1]):
            x, y, z = normals[i, 0], normals[i, 1], normals[i, 2]
            if not np.isfinite(x + y + z):
                continue
            band = min(int(abs(z) * n_bands), n_bands - 1)
            total += 1.0
            if x * x + y * y < UPRIGHT * UPRIGHT:
                for j in range(n):
                    image[band, j] += 1.0 / n
                continue
            place = np.arctan2(y, x) / (2.0 * np.pi) * n
            low = np.floor(place)
            share = place - low
            cell = int(low) % n
            for half in range(2):
                at = (cell + half * (n // 2)) % n
                image[band, at] += 0.5 * (1.0 - share)
                image[band, (at + 1) % n] += 0.5 * share
        if total > 0.0:
            for band in range(n_bands):
                for j in range(n):
                    out[m, band, j] = image[band, j] / total
