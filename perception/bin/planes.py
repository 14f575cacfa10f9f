"""Planes among points, by sample consensus (RANSAC; Fischler and Bolles, 1981) and a robust fit to the inliers."""

import numpy as np
from numpy.typing import NDArray

from perception.bin.cloud import Plane
from perception.geometry import Floats

TOLERANCE = 0.003  # distance from a plane up to which points support it before its noise is known [m]
LEAST_NOISE = 0.0002  # noise below which a finer fit makes no difference [m]
MOST_NOISE = 0.003  # noise above which points are no plane [m]
_HYPOTHESES, _MOST_POINTS = 500, 1500  # triples that are tried, and points that they are tried on
_FITTED = 12  # number of the best triples whose planes are fitted to their inliers
MOST_BINS = 1_000_000  # bins of a histogram up to which gaps are kept
GAP = 5  # empty bins more than this many keep the sums over neighbours of both sides apart
_FLAT = 0.0005  # noise below which a plane is no better than another one [m]


def find_plane(points_cam: Floats, up_cam: Floats, tilt: float, rng: np.random.Generator) -> Plane | None:
    """Return the plane that most points support; None if there are too few points, or no plane is tilted so little.

    Args:
        points_cam: (N, 3) points in the camera frame [m].
        up_cam: (3,) expected unit normal.
        tilt: Largest angle between it and the normal [rad].
        rng: Source of the random triples.
    """
    if len(points_cam) < 30:
        return None
    points = points_cam if len(points_cam) <= _MOST_POINTS else points_cam[rng.choice(len(points_cam), _MOST_POINTS)]
    triples = points[rng.integers(len(points), size=(_HYPOTHESES, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    cosine = np.abs(normals @ up_cam)
    allowed = (lengths > 1e-9) & (cosine >= np.cos(tilt) * lengths)
    if not allowed.any():
        return None
    normals = normals[allowed] / lengths[allowed, None]
    offsets = np.einsum("ij,ij->i", normals, triples[allowed, 0])
    distances = normals.astype(np.float32) @ points.T.astype(np.float32)
    distances -= offsets[:, None].astype(np.float32)
    support = np.count_nonzero(np.abs(distances) <= TOLERANCE, axis=1)
    signs = np.sign(normals @ up_cam)
    fitted = [
        fit_plane(points, Plane(normal=signs[k] * normals[k], offset=float(signs[k] * offsets[k]), noise=0.001))
        for k in np.argsort(-support, kind="stable")[:_FITTED]
    ]
    planes = [plane for plane in fitted if plane is not None]
    if not planes:
        return None
    return fit_plane(points_cam, max(planes, key=lambda plane: _support(points, plane)))


def _support(points_cam: Floats, plane: Plane) -> float:
    """Return the number of points on a plane by its noise; a flat plane beats a thick slice of a pile."""
    on = np.abs(plane.heights(points_cam)) <= 2.5 * max(plane.noise, LEAST_NOISE)
    return float(np.count_nonzero(on)) / max(plane.noise, _FLAT)


def fit_plane(points_cam: Floats, plane: Plane, reach: float = TOLERANCE) -> Plane | None:
    """Return the plane through the points near another one; None if they are no plane.

    Args:
        points_cam: (N, 3) points in the camera frame [m].
        plane: First guess.
        reach: Distance from it within which points are used [m].
    """
    for _ in range(3):
        heights = plane.heights(points_cam)
        near = np.abs(heights) <= reach
        if np.count_nonzero(near) < 30:
            return None
        plane = _least_squares(points_cam[near], plane.normal)
        reach = max(2.5 * plane.noise, 3 * LEAST_NOISE)
    return plane if plane.noise <= MOST_NOISE else None


def _least_squares(points_cam: Floats, up_cam: Floats) -> Plane:
    middle = points_cam.mean(axis=0)
    centred = points_cam - middle
    _, vectors = np.linalg.eigh(centred.T @ centred)
    normal = vectors[:, 0] * np.sign(vectors[:, 0] @ up_cam)
    noise = robust_std(centred @ normal)
    return Plane(normal=normal, offset=float(normal @ middle), noise=noise)


def robust_std(values: Floats) -> float:
    """Return the standard deviation of (N,) values about 0 from the median of their absolute values."""
    return 1.4826 * float(np.median(np.abs(values)))


def peaks(heights: Floats, width: float, share: float) -> Floats:
    """Return the heights at which many points lie, most first: the local maxima of a histogram.

    Args:
        heights: (N,) heights [m].
        width: Width of a bin of the histogram [m].
        share: Least share of the points in a maximum and its two neighbours, in [0, 1].
    """
    if len(heights) == 0:
        return np.zeros(0)
    low = float(heights.min()) - width
    levels, places = _without_gaps(((heights - low) / width).astype(np.int64))
    counts = np.pad(np.bincount(places, minlength=3), 2)
    sums: NDArray[np.int64] = counts[:-2] + counts[1:-1] + counts[2:]
    smooth = sums + counts[1:-1]  # the middle counts twice, so that a single full bin is the maximum
    middle = sums[1:-1]
    maxima = (smooth[1:-1] >= smooth[:-2]) & (smooth[1:-1] > smooth[2:]) & (middle >= share * len(heights))
    found = np.flatnonzero(maxima)
    found = found[np.argsort(-middle[found], kind="stable")]
    if levels is not None:
        found = levels[found]
    return np.asarray(low + (found + 0.5) * width, np.float64)


def _without_gaps(bins: NDArray[np.int64]) -> tuple[NDArray[np.int64] | None, NDArray[np.int64]]:
    """Return the number of each place in a histogram, and the (N,) place of each point, given its bin.

    The numbers are None where each place is its own number. Where points lie farther apart than `MOST_BINS` bins, long
    gaps between them are cut down to `GAP` bins, so that a few absurd heights need no memory for all that lies between.
    """
    if bins.max() < MOST_BINS:
        return None, bins
    levels, where = np.unique(bins, return_inverse=True)
    steps = np.minimum(np.diff(levels, prepend=levels[0]), GAP)
    places = np.cumsum(steps)
    numbers = np.zeros(int(places[-1]) + 1, np.int64)
    numbers[places] = levels  # the places between are empty, and no maxima
    return numbers, places[where]
