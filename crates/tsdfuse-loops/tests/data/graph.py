"""Makes graph.g2o, a pose graph of two rounds with noise, and optimum.g2o, where its sum of squared errors is least: found by scipy, with derivatives by
differences. The error of an edge is shift and turn (as a vector) of measured^-1 (from^-1 to); the first node is fixed.

usage: graph.py FOLDER
"""

import sys

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

N, LAP = 40, 20
rng = np.random.default_rng(3)


def product(a, b):
    return a[0] * b[0], a[1] + a[0].apply(b[1])


def inverse(a):
    return a[0].inv(), -a[0].inv().apply(a[1])


def at(i):
    angle = 2 * np.pi * i / LAP
    turn = Rotation.from_rotvec([0.1 * np.sin(0.2 * i), 0.05 * np.cos(0.3 * i), angle])
    return turn, np.array([8 * np.cos(angle), 8 * np.sin(angle), 0.05 * i])


def edge(i, j, shift, turn):
    mixed = 0.3 * rng.normal(size=(6, 6)) + np.eye(6)
    scale = np.diag([1 / shift] * 3 + [1 / turn] * 3)
    noise = Rotation.from_rotvec(rng.normal(0, turn, 3)), rng.normal(0, shift, 3)
    measured = product(product(inverse(at(i)), at(j)), noise)
    return i, j, measured, scale @ mixed @ mixed.T @ scale


edges = [edge(i, i + 1, 0.05, 0.02) for i in range(N - 1)]
edges += [edge(i, i + LAP, 0.03, 0.01) for i in range(0, N - LAP, 3)]
begin = [at(0)]
for _, _, measured, _ in edges[: N - 1]:
    begin.append(product(begin[-1], measured))
roots = [np.linalg.cholesky(information).T for *_, information in edges]


def moved(x):
    x = x.reshape(-1, 6)
    rest = [(p[0] * Rotation.from_rotvec(v[3:]), p[1] + v[:3]) for p, v in zip(begin[1:], x)]
    return begin[:1] + rest


def errors(x):
    poses = moved(x)
    off = [product(inverse(m), product(inverse(poses[i]), poses[j])) for i, j, m, _ in edges]
    return np.concatenate([root @ np.r_[o[1], o[0].as_rotvec()] for root, o in zip(roots, off)])


found = least_squares(errors, np.zeros(6 * (N - 1)), xtol=1e-14, ftol=1e-14, gtol=1e-12, method="lm")


def text(pose):
    return " ".join("%.12g" % v for v in [*pose[1], *pose[0].as_quat()])


def write(name, poses, head):
    with open(f"{sys.argv[1]}/{name}", "w") as out:
        print(head, file=out)
        for i, pose in enumerate(poses):
            print(f"VERTEX_SE3:QUAT {i} {text(pose)}", file=out)
        for i, j, measured, information in edges:
            upper = " ".join("%.12g" % information[a, b] for a in range(6) for b in range(a, 6))
            print(f"EDGE_SE3:QUAT {i} {j} {text(measured)} {upper}", file=out)


write("graph.g2o", begin, "# costs %.9f" % (errors(np.zeros(6 * (N - 1))) ** 2).sum())
write("optimum.g2o", moved(found.x), "# costs %.9f" % (2 * found.cost))
