"""Attitudes computed again in 80-bit arithmetic, by other means than the code under test.

Real components instead of complex pairs, libm instead of series, loops instead of a tree. The
serial oracle is the definition; the blocked one is the same product, fast enough for millions of
samples, and is itself checked against the serial one. Products and increments are in the precision
of what they are given.
"""

from itertools import pairwise

import numpy as np

from quatprop.kinematics.cubic import MAX_RATIO, MAX_RATIO_ONE_SIDED

L = np.longdouble
RUN = 1000

# Without 80-bit extended precision (64-bit mantissa) there is nothing to compare with.
EXTENDED = np.finfo(L).nmant >= 63


def product(p, q):
    """Return the Hamilton product of tuples of components."""
    a, b, c, d = p
    w, x, y, z = q
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


def rotation_vectors(t_ns, rate, method="start"):
    """Return rotation vectors ``(N - 1, 3)`` in 80 bits, by the formula of the method."""
    dt = (np.diff(t_ns).astype(L) / L(10) ** 9)[:, None]
    u, v = rate[:-1].astype(L), rate[1:].astype(L)
    mean = (u + v) / 2 * dt
    return {
        "start": lambda: u * dt,
        "end": lambda: v * dt,
        "mean": lambda: mean,
        "coning": lambda: mean + dt**2 / 12 * np.cross(u, v),
        "cubic": lambda: mean + dt**2 / 12 * np.cross(u, v) - dt**3 / 6 * curvature(dt, u, v),
    }[method]()


def curvature(dt, u, v):
    """Return the weighted second divided differences of the rate, sample by sample."""
    dt = dt[:, 0]
    slope = (v - u) / dt[:, None]
    # By sample: the second difference and the ratio of the intervals.
    none = (np.zeros(3, L), np.inf)
    samples = [
        ((slope[k] - slope[k - 1]) / (a + b), max(a, b) / min(a, b))
        for k, (a, b) in enumerate(pairwise(dt), 1)
    ]
    rows = []
    for k, ((left, p), (right, q)) in enumerate(pairwise([none, *samples, none])):
        if max(p, q) <= MAX_RATIO:
            weight = (dt[k - 1] + dt[k] / 2) / dt[k - 1 : k + 2].sum()
            rows.append((1 - weight) * left + weight * right)
        elif min(p, q) <= MAX_RATIO_ONE_SIDED:
            rows.append(left if p < q else right)
        else:
            rows.append(np.zeros(3, L))
    return np.array(rows, L)


def quintic(t_ns, rate):
    """Return rotation vectors ``(N - 1, 3)`` for products on the left, interval by interval.

    Six samples are weighted by Lagrange's formula at the three nodes; intervals are not too unlike.
    """
    t, w = (t_ns - t_ns[0]).astype(L) / L(10) ** 9, rate.astype(L)
    return np.array([_quintic_step(t, w, k) for k in range(len(t) - 1)], L)


def _quintic_step(t, w, k):
    six = next(
        range(start, start + 6)
        for start in (k - 2, k - 3, k - 1, k - 4, k)
        if 0 <= start <= len(t) - 6 and np.ptp(np.log(np.diff(t[start : start + 6]))) <= np.log(2)
    )
    h = t[k + 1] - t[k]
    first, middle, last = (
        sum(
            w[i] * np.prod([(t[k] + c * h - t[j]) / (t[i] - t[j]) for j in six if j != i])
            for i in six
        )
        for c in (L(1) / 2 - np.sqrt(L(15)) / 10, L(1) / 2, L(1) / 2 + np.sqrt(L(15)) / 10)
    )
    a1, a2 = h * middle, h * np.sqrt(L(15)) / 3 * (last - first)
    a3 = 10 * h / 3 * (last - 2 * middle + first)
    c1 = np.cross(a1, a2)
    c2 = -np.cross(a1, 2 * a3 + c1) / 60
    return a1 + a3 / 12 + np.cross(-20 * a1 - a3 + c1, a2 + c2) / 240


def increments(rotvec):
    """Return unit quaternions as a tuple of components ``(M,)``."""
    angle = np.sqrt((rotvec**2).sum(axis=1))
    ratio = np.where(angle == 0, 0.5, np.sin(angle / 2) / np.where(angle == 0, 1, angle))
    return (np.cos(angle / 2), *(rotvec.T * ratio))


def unit(q):
    """Return components divided by their length."""
    length = np.sqrt(sum(component**2 for component in q))
    return tuple(component / length for component in q)


def serial(t_ns, rate, q0=(1, 0, 0, 0), method="start", rates="body"):
    """Return attitudes ``(N, 4)``, one step after the other."""
    if method == "quintic":
        rotvec = quintic(t_ns, rate) if rates == "inertial" else -quintic(t_ns, -rate)
    else:
        rotvec = rotation_vectors(t_ns, rate, method)
    if rates == "inertial" and method in {"coning", "cubic"}:
        # Left multiplication takes the commutator, which is the coning term, with the other sign.
        mean, coning = (rotation_vectors(t_ns, rate, each) for each in ("mean", "coning"))
        rotvec = rotvec + 2 * (mean - coning)
    steps = increments(rotvec)
    q = unit(tuple(L(number) for number in q0))
    rows = [q]
    for k in range(len(t_ns) - 1):
        step = tuple(component[k] for component in steps)
        q = unit(product(q, step) if rates == "body" else product(step, q))
        rows.append(q)
    return np.array(rows, L)


def blocked(t_ns, rate):
    """Return attitudes ``(N, 4)`` from the identity, runs of RUN samples side by side."""
    steps = increments(rotation_vectors(t_ns, rate))
    count = len(steps[0])
    runs = -(-count // RUN)
    padded = np.zeros((4, runs * RUN), L)
    padded[0] = 1
    padded[:, :count] = steps
    padded = padded.reshape(4, runs, RUN)
    within = np.empty_like(padded)
    q = within[..., 0] = padded[..., 0]
    for k in range(1, RUN):
        q = within[..., k] = np.array(product(q, padded[..., k]))
    begin, carry = [], (L(1), L(0), L(0), L(0))
    for run in range(runs):
        begin.append(carry)
        carry = unit(product(carry, within[:, run, -1]))
    begin = np.array(begin, L).T[..., None]
    rows = np.array(unit(product(begin, within))).reshape(4, -1)[:, :count].T
    return np.concatenate([np.array([[1, 0, 0, 0]], L), rows])


def angle(p, q):
    """Return geodesic angles ``(N,)``, rad, between rows."""
    p, q = p.astype(L).T, q.astype(L).T
    w, x, y, z = product((p[0], -p[1], -p[2], -p[3]), q)
    return 2 * np.arctan2(np.sqrt(x * x + y * y + z * z), np.abs(w))
