"""The storage order of quaternion components, independent of their convention.

Inside quatprop there is one layout, ``wxyz``. Others exist only in the columns of files. A layout
is an order of the same four numbers, never another rotation: conjugates and the JPL convention are
not layouts.
"""

from __future__ import annotations

from typing import NamedTuple

from quatprop.errors import UsageError
from quatprop.settings.choices import LAYOUTS
from quatprop.text import listed, quoted


class Layout(NamedTuple):
    """An order of the four components.

    `name`: ``"scalar-first"`` or ``"scalar-last"``, as in the provenance
    `order`: for each stored column, the index of its component in ``wxyz``
    """

    name: str
    order: tuple[int, int, int, int]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the stored columns, in order."""
        return tuple(("qw", "qx", "qy", "qz")[component] for component in self.order)


SCALAR_FIRST = Layout("scalar-first", (0, 1, 2, 3))
SCALAR_LAST = Layout("scalar-last", (1, 2, 3, 0))

_NAMED = dict(zip(LAYOUTS, (SCALAR_FIRST, SCALAR_LAST) * 2, strict=True))


def layout_named(name: str) -> Layout:
    """Return the layout of a name."""
    if name not in LAYOUTS:
        raise UsageError(f"no layout {quoted(name)}; choose one of {listed(LAYOUTS)}")
    return _NAMED[name]
