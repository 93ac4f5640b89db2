"""Attitudes computed again in 80-bit arithmetic, by other means than the code under test.

Real components instead of complex pairs, libm instead of series, loops instead of a tree. The
serial oracle is the definition; the blocked one is the same product, fast enough for millions of
samples, and is itself checked against the serial one. Products and increments are in the precision
of what they are given.
"""

import numpy as np

L = np.longdouble
NS = 1_000_000_000
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


def rotation_vector(t_ns, rate, k, after_ns, method="start", sign=1):  # noqa: PLR0913, PLR0917
    """Return the rotation vector from sample k over some time, at most to the next sample.

    `sign`: -1 for rates whose rotations multiply on the left; their commutators have the other sign
    """
    u, v, s = *rate[k : k + 2].astype(L), L(after_ns) / NS
    if method in {"start", "end", "mean"}:
        # Of a rate that is linear in time, the mean is that of its ends.
        mean = u + (v - u) / 2 * L(after_ns) / max(t_ns[k + 1] - t_ns[k], 1)
        return {"start": u, "end": v, "mean": mean}[method] * s
    six = _six_around(t_ns, k) if method == "quintic" else None
    if six is not None:
        # Magnus' series, of the rates at three Gauss nodes.
        at = s / 2 * (1 + np.sqrt(L(15)) / 5 * np.arange(-1, 2))
        first, middle, last = -sign * _polynomial(t_ns, rate, k, six, at)
        a1, a2 = s * middle, s * np.sqrt(L(15)) / 3 * (last - first)
        a3 = 10 * s / 3 * (last - 2 * middle + first)
        c1 = np.cross(a1, a2)
        c2 = -np.cross(a1, 2 * a3 + c1) / 60
        return -sign * (a1 + a3 / 12 + np.cross(-20 * a1 - a3 + c1, a2 + c2) / 240)
    # Exact for a polynomial of third degree.
    through = _samples_around(t_ns, k) if method in {"cubic", "quintic"} else [k, k + 1]
    middle, end = _polynomial(t_ns, rate, k, through, np.array([s / 2, s]))
    return (u + 4 * middle + end) * s / 6 + sign * s**2 / 12 * np.cross(u, end)


def _six_around(t_ns, k):
    """Return six samples of similar spacing around an interval, or None."""
    for start in (k - 2, k - 3, k - 1, k - 4, k):
        step = np.diff(t_ns[start : start + 6]) if start >= 0 else np.zeros(0)
        if len(step) == 5 and 0 < step.max() <= (4 if start == k - 2 else 2) * step.min():
            return range(start, start + 6)
    return None


def _samples_around(t_ns, k):
    """Return two to four samples around an interval."""

    def ratio(j):
        """Return by what factor the intervals around a sample differ."""
        step = np.diff(t_ns[max(j - 1, 0) : j + 2])
        return max(step) / min(step) if len(step) == 2 and min(step) else np.inf

    left, right = ratio(k), ratio(k + 1)
    if max(left, right) <= 4:
        return [k - 1, k, k + 1, k + 2]
    if min(left, right) <= 2:
        return [k - 1, k, k + 1] if left <= right else [k, k + 1, k + 2]
    return [k, k + 1]


def _polynomial(t_ns, rate, k, through, at):
    """Return rates at times after sample k, s, on the polynomial through samples."""
    if t_ns[k + 1] == t_ns[k]:
        return np.tile(rate[k].astype(L), (len(at), 1))
    nodes, rates = (t_ns[list(through)] - t_ns[k]).astype(L) / NS, np.zeros((len(at), 3), L)
    for j, node in enumerate(nodes):
        others = np.delete(nodes, j)
        share = np.prod((at[:, None] - others) / (node - others), axis=1)
        rates += share[:, None] * rate[through[j]]
    return rates


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
    sign, interval_ns = 1 if rates == "body" else -1, np.diff(t_ns)
    rotvecs = [
        rotation_vector(t_ns, rate, k, after_ns, method, sign)
        for k, after_ns in enumerate(interval_ns)
    ]
    steps = increments(np.array(rotvecs))
    q = unit(tuple(L(number) for number in q0))
    rows = [q]
    for k in range(len(t_ns) - 1):
        step = tuple(component[k] for component in steps)
        q = unit(product(q, step) if rates == "body" else product(step, q))
        rows.append(q)
    return np.array(rows, L)


def blocked(t_ns, rate):
    """Return attitudes ``(N, 4)`` from the identity, runs of RUN samples side by side."""
    steps = increments(rate[:-1].astype(L) * (np.diff(t_ns).astype(L) / NS)[:, None])
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
