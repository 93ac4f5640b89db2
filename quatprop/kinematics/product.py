"""The product of many quaternions, as a tree.

A sequential loop of q[k+1] = q[k] dq[k] (eq. 36) is slow in NumPy, one sample at a time. But the
product is associative, so the steps of a tile are composed as a tree: neighbouring steps are
multiplied to steps over two intervals, those to steps over four, and so on; then the attitudes in
between are filled in from the top down. Every level is a few NumPy calls, and rounding errors grow
with the depth of the tree instead of its width.

A quaternion w + xi + yj + zk is stored as a pair of complex numbers, a = w + xi and b = y + zi,
arrays ``(2, n)``: the product (a c - b d*, a d + b c*) then takes four complex multiplications.
NumPy uses fused multiply-add in them if the processor has it (x86 since 2013, and 64-bit ARM); on
others the last bits differ. Real arithmetic would not depend on it, but takes a third more time for
all computations from rates to attitudes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from quatprop.kinematics.half_angle import half_angle

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from quatprop.arrays import Float64

    Pairs = NDArray[np.complex128]
    Wxyz = tuple[float, float, float, float]

LEVELS: Final = 8
"""Number of levels of the tree. The few steps that remain are composed by a loop, which is faster
than more levels."""

PADDING: Final = 2**LEVELS * 8
"""The steps of a tile are padded to a multiple of this, so that arrays have a multiple of 8
elements on every level: NumPy rounds the remainder, which does not fill a register, differently."""


def tile_steps(rotvec: Float64) -> Pairs:
    """Return the unit quaternions of rotation vectors ``(n, 3)`` (eq. 35), padded for a tree.

    They are padded with identities to a multiple of :data:`PADDING`; products with these are exact.
    """
    x, y, z = rotvec.T
    count = len(x)
    cosine, ratio = half_angle(x * x + y * y + z * z)
    steps = np.empty((2, -(-count // PADDING) * PADDING), np.complex128)
    steps[0, count:], steps[1, count:] = 1, 0
    a, b = steps[:, :count]
    a.real = cosine
    np.multiply(x, ratio, out=a.imag)
    np.multiply(y, ratio, out=b.real)
    np.multiply(z, ratio, out=b.imag)
    return steps


def product_scan(first: Wxyz, steps: Pairs, levels: int = LEVELS) -> Pairs:
    """Return the first attitude and those after each of `n` steps, ``(2, n + 1)``."""
    if not levels:
        return np.array(product_loop(first, steps)).view(np.complex128).T.copy()
    even = steps[:, 0::2]
    every = np.empty((2, steps.shape[1] + 1), np.complex128)
    every[:, 0::2] = every_other = product_scan(first, compose_pairs(steps, 1), levels - 1)
    _multiply(every_other[:, :-1], even, out=every[:, 1::2])
    return every


def compose_pairs(steps: Pairs, levels: int) -> Pairs:
    """Return the steps some levels higher in the tree, each a product of 2**levels steps."""
    for _ in range(levels):
        even, odd = steps[:, 0::2], steps[:, 1::2]
        steps = np.empty_like(odd)
        _multiply(even, odd, out=steps)
    return steps


def product_loop(first: Wxyz, steps: Pairs) -> list[Wxyz]:
    """Return the same as :func:`product_scan`, computed one step after another."""
    # Real numbers: some interpreters compute complex products with fused multiply-add.
    w, x, y, z = first
    attitudes = [first]
    for a, b, c, d in np.ascontiguousarray(steps.T).view(np.float64).tolist():
        w, x, y, z = (
            w * a - x * b - y * c - z * d,
            w * b + x * a + y * d - z * c,
            w * c - x * d + y * a + z * b,
            w * d + x * c - y * b + z * a,
        )
        attitudes.append((w, x, y, z))
    return attitudes


def _multiply(p: Pairs, q: Pairs, out: Pairs) -> None:
    """Write the Hamilton products p q: a c - b d* and a d + b c*."""
    (a, b), (c, d), (left, right) = p, q, out
    np.multiply(a, c, out=left)
    term = d.conj()
    term *= b
    left -= term
    np.multiply(a, d, out=right)
    np.conjugate(c, out=term)
    term *= b
    right += term


def write_rows(pairs: Pairs, rows: Float64) -> None:
    """Write pairs ``(2, n)`` as rows wxyz ``(n, 4)`` of unit length."""
    a, b = pairs
    components = (a.real, a.imag, b.real, b.imag)
    ww, xx, yy, zz = map(np.square, components)
    # 1/sqrt(s) for an s that differs from 1 by rounding errors only.
    scale = 1.5 - 0.5 * (ww + xx + yy + zz)
    for component, column in zip(components, rows.T, strict=True):
        np.multiply(component, scale, out=column)


def unit(wxyz: Wxyz) -> Wxyz:
    """Return an attitude of unit length, rounded as by :func:`write_rows`."""
    w, x, y, z = wxyz
    scale = 1.5 - 0.5 * (w * w + x * x + y * y + z * z)
    return w * scale, x * scale, y * scale, z * scale
