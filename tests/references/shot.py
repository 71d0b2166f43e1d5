"""Reference implementations of SHOT and of layer features, point by point."""

import numpy as np


def shot(points, normals, radius):
    """Return the descriptor at the origin, with triangular weights of one bin width around bin centres."""
    distance = np.linalg.norm(points, axis=1)
    inside = distance <= radius
    points, normals, distance = points[inside], normals[inside], distance[inside]
    covariance = sum((radius - d) * np.outer(p, p) for p, d in zip(points, distance, strict=True))
    vectors = np.linalg.eigh(covariance)[1]
    x, z = vectors[:, 2], vectors[:, 0]
    x = x if (points @ x > 0).sum() >= (points @ x < 0).sum() else -x
    z = z if (points @ z > 0).sum() >= (points @ z < 0).sum() else -z
    y = np.cross(z, x)

    def shares(place, n, circular=False):
        """Return the share of each bin for positions 0 to n."""
        middles = np.arange(n) + 0.5
        away = np.abs((place if circular else np.clip(place, 0.5, n - 0.5)) - middles)
        away = np.minimum(away, n - away) if circular else away
        return np.maximum(1 - away, 0)

    out = np.zeros((8, 2, 2, 11))
    for p, normal, d in zip(points, normals, distance, strict=True):
        azimuth = np.arctan2(p @ y, p @ x)
        elevation = np.arcsin(np.clip(p @ z / d, -1, 1)) if d > 0 else 0.0
        parts = (
            shares((azimuth / (2 * np.pi) + 0.5) * 8, 8, circular=True),
            shares((elevation / np.pi + 0.5) * 2, 2),
            shares(d / radius * 2, 2),
            shares((normal @ z + 1) / 2 * 11, 11),
        )
        out += np.einsum("a,b,c,d->abcd", *parts)
    return (out / np.linalg.norm(out)).ravel()


def layers(points, n_layers):
    """Return ten features of each layer."""
    plan = points[:, :2] - points[:, :2].mean(axis=0)
    vectors = np.linalg.eigh(np.cov(plan.T))[1]
    a, b = plan @ vectors[:, 1], plan @ vectors[:, 0]
    z = points[:, 2] - points[:, 2].min()
    layer = np.minimum((z / z.max() * n_layers).astype(int), n_layers - 1)
    rows = []
    for k in range(n_layers):
        m = layer == k
        if not m.any():
            rows.append(np.zeros(10))
            continue
        r = np.hypot(a[m], b[m])
        rows.append(
            [
                m.mean(),
                np.ptp(a[m]),
                np.ptp(b[m]),
                a[m].std(),
                b[m].std(),
                abs(a[m].mean()),
                abs(b[m].mean()),
                r.mean(),
                r.max(),
                z[m].std(),
            ]
        )
    return np.concatenate(rows)
