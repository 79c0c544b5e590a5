"""The figures of a comparison once more, by numpy, scipy and (where it is there) Open3D.

usage: independent.py FOLDER VOXEL_M ACCURACY_LIMIT_M COMPLETENESS_LIMIT_M

FOLDER holds samples.f64, reference.f64 and vertices.f64 (x y z) and triangles.u32. Prints JSON.
"""
import json
import sys

import numpy as np
from scipy.spatial import cKDTree

folder, voxel, accuracy_limit, completeness_limit = sys.argv[1], *map(float, sys.argv[2:])
samples, reference, vertices = (
    np.fromfile(f"{folder}/{name}.f64").reshape(-1, 3) for name in ("samples", "reference", "vertices"))
triangles = vertices[np.fromfile(f"{folder}/triangles.u32", np.uint32).reshape(-1, 3)]


def figures(d):
    return {"mean_m": d.mean(), "std_m": d.std(), "rmse_m": np.sqrt((d ** 2).mean()), "median_m": np.median(d),
            "p90_m": np.percentile(d, 90), "p95_m": np.percentile(d, 95), "p99_m": np.percentile(d, 99), "max_m": d.max()}


def to_surface(points):
    """Over each triangle: the foot of the perpendicular if it lies inside, or else the sides."""
    best = np.full(len(points), np.inf)
    for t in triangles:
        for p, q in ((t[0], t[1]), (t[1], t[2]), (t[2], t[0])):
            along = np.clip((points - p) @ (q - p) / ((q - p) @ (q - p)), 0, 1)
            best = np.minimum(best, np.linalg.norm(points - p - along[:, None] * (q - p), axis=1))
        edges = np.stack([t[1] - t[0], t[2] - t[0]], axis=1)
        inner = np.linalg.lstsq(edges, (points - t[0]).T, rcond=None)[0]
        inside = (inner >= 0).all(axis=0) & (inner.sum(axis=0) <= 1)
        height = np.linalg.norm((points - t[0]).T - edges @ inner, axis=0)
        best = np.where(inside, np.minimum(best, height), best)
    return best


def down_sample(points):
    try:
        import open3d
    except ImportError:
        voxels = np.floor((points - (points.min(axis=0) - voxel / 2)) / voxel).astype(np.int64)
        _, number = np.unique(voxels, axis=0, return_inverse=True)
        number = number.ravel()
        sums = np.stack([np.bincount(number, points[:, axis]) for axis in range(3)], axis=1)
        return sums / np.bincount(number)[:, None]
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    return np.asarray(cloud.voxel_down_sample(voxel).points)


there, back = cKDTree(reference).query(samples)[0], to_surface(reference)
thin_samples, thin_reference = down_sample(samples), down_sample(reference)
accuracy = cKDTree(thin_reference).query(thin_samples)[0]
completeness = np.minimum(cKDTree(thin_samples).query(thin_reference)[0], completeness_limit)
json.dump({
    "there": figures(there), "back": figures(back),
    "precision": (there <= 0.05).mean(), "completeness": (back <= 0.05).mean(),
    "thin_there": figures(accuracy[accuracy < accuracy_limit]), "thin_back": figures(completeness),
    "thin_counts": [len(thin_samples), len(thin_reference)],
}, sys.stdout)
