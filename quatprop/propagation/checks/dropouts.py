"""Dropouts: rows that are zero, repeated or at full scale on all axes between rates that are not.

No sample is changed here; each finding is one sentence with its place.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from quatprop.base.text import Remark, Setting
from quatprop.propagation.checks.samples import FROZEN_SAMPLES, SMALLEST_RANGE, Samples

if TYPE_CHECKING:
    from collections.abc import Iterator

    from quatprop.base.arrays import Bool, Float64, Intp
    from quatprop.propagation.checks.samples import Unit


CONTEXT = 12
"""Samples on either side of a dropout that show how much the rates change."""

LONG = 20
"""This many equal rows are no coincidence where nearly every row next to them differs."""

JUMP = 12.0
"""Smallest jump to or from a dropout, in units of the median change of the rates next
to it; half as large if it is long."""

SMALLEST_JUMP = math.radians(2.0)
"""rad/s: a smaller one does not matter."""

GOES_ON = 0.5
"""A short dropout jumps from the rates and back: they differ by less than this share of it."""

EQUAL = 1e-4
"""Largest relative difference of equal ends of a range, such as -32768 and 32767."""

CHANGING = 0.8
"""Share of the rows next to a dropout that differ from their neighbours."""

AT_REST = math.radians(5.0)
"""rad/s: smaller rates may be repeated by a coarse sensor that has come to rest."""

FILLED = 0.2
"""Smallest number of stretches of zeros, relative to that of other rows, of rates that were joined
to faster rows."""

FEWEST_FILLED = 40
"""Fewest such stretches."""

ACROSS = 0.3
"""Squared change of the rates across these stretches, relative to the squared rates next to them,
below which they go on as if no zeros were there."""

STEPS, REACH = 10, 0.5
"""Rates next to these stretches are larger than the smallest rate, and reach this share of the
largest: of a sensor that shows small rates as zero they do not."""

_HELD, _SAME, _ZERO = range(3)


class _Stretches(NamedTuple):
    """Successive equal rows, each from a place to another, and their number."""

    begins: Intp
    ends: Intp
    lengths: Intp


class _Found(NamedTuple):
    """Dropouts of a kind.

    `first_ns`, `last_ns`, `value`: of the first stretch
    `nearby`: the largest rate next to them, rad/s
    """

    samples: int = 0
    stretches: int = 0
    first_ns: int = 0
    last_ns: int = 0
    value: float = 0.0
    nearby: float = 0.0

    def after(self, earlier: _Found) -> _Found:
        """Return all, of which some were found earlier."""
        return earlier._replace(
            samples=earlier.samples + self.samples,
            stretches=earlier.stretches + self.stretches,
            nearby=max(earlier.nearby, self.nearby),
        )


class Filled:
    """Finds rates that were joined to faster rows, as of a force plate, with zeros filled in."""

    def __init__(self) -> None:
        self.rows = self.zeros = self._first_ns = self._stretches = 0
        self._size = self._change = self._nearby = 0.0
        self._largest, self._smallest = 0.0, math.inf
        # The last rate that is not zero, and how many zeros came after it.
        self._last, self._since = np.empty((3, 0)), 0

    def add(self, samples: Samples, extremes: Float64) -> None:
        """Add new samples, as :meth:`Dropouts.add` does."""
        columns, t_ns = samples
        self.rows += columns.shape[1]
        self._largest = max(self._largest, float(extremes.max()))
        if not (columns[0] == columns[1]).any():
            if self._since:
                self._add_stretches(columns[:, :1], np.array([self._since]))
            self._last, self._since = columns[:, -1:].copy(), 0
            return
        is_zero = ~columns.any(axis=0)
        places = np.flatnonzero(~is_zero)
        zeros = columns.shape[1] - len(places)
        if zeros and not self.zeros:
            self._first_ns = int(t_ns[is_zero.argmax()])
        self.zeros += zeros
        if not len(places):
            self._since += zeros
            return
        self._add_stretches(columns[:, places], np.diff(places, prepend=-1 - self._since) - 1)
        self._last = columns[:, places[-1:]].copy()
        self._since = columns.shape[1] - 1 - int(places[-1])

    def _add_stretches(self, rate: Float64, zeros: Intp) -> None:
        """Add rates that are not zero, of which some have zeros before them."""
        every = np.concatenate([self._last, rate], axis=1)
        # Zeros before the first rate are between nothing.
        after = np.flatnonzero(zeros[rate.shape[1] - every.shape[1] + 1 :]) + 1
        if not len(after):
            return
        before, change = every[:, after - 1], every[:, after] - every[:, after - 1]
        self._stretches += len(after)
        self._size += float(np.einsum("ij,ij->", before, before))
        self._change += float(np.einsum("ij,ij->", change, change))
        sizes = np.abs(every[:, after])
        self._nearby = max(self._nearby, float(sizes.max()))
        self._smallest = min(self._smallest, float(sizes[sizes > 0].min(initial=math.inf)))

    @property
    def are_found(self) -> bool:
        """Whether the rates go on across so many stretches of zeros."""
        usual = math.sqrt(self._size / max(self._stretches, 1))
        return (
            self._stretches > max(FEWEST_FILLED, FILLED * (self.rows - self.zeros))
            and usual > max(SMALLEST_JUMP, STEPS * self._smallest)
            and self._nearby > REACH * self._largest
            and self._change < ACROSS * self._size
        )

    def text(self, unit: Unit) -> str:
        """Return the sentence on it."""
        name, scale = unit
        return (
            f"all three rates are exactly 0 in {self.zeros} of {self.rows} rows, first at t = "
            f"{self._first_ns} ns, and go on between them, up to {self._nearby / scale:.4g} {name},"
            " as if these rows were not there: were they joined to faster rows, with zeros filled "
            f"in? remove these rows, or leave their rates empty and use "
            f"{Setting('on_nonfinite', 'drop')}"
        )


class Dropouts:
    """Finds dropouts.

    Rows at the end of a block that cannot be judged yet are kept for the next one. Of a stretch of
    equal rows only the ends are kept, however long it is.
    """

    def __init__(self) -> None:
        self._kept = Samples()
        # Rows that were left out of the stretch that begins at a place among those kept.
        self._left_out, self._place = 0, -1
        self._step = math.inf
        self._decided = 0
        self._found = {kind: _Found() for kind in (_HELD, _SAME, _ZERO)}
        self._filled = Filled()

    @np.errstate(over="ignore", invalid="ignore")  # of rates of a damaged log
    def add(self, samples: Samples, extremes: Float64) -> None:
        """Add new samples.

        `extremes`: largest magnitude of each axis in them, shape ``(3,)``
        """
        self._filled.add(samples, extremes)
        may_begin = self._kept.size > 0 and self._is_open()
        if may_begin or _has_candidates(samples.columns, extremes):
            self._look(samples.after(self._kept), is_end=False)
        else:
            self._keep(samples, max(samples.size - 2 * CONTEXT, 0), 0)

    @property
    def are_at_an_end(self) -> bool:
        """Whether some are rows with the same rate on all axes, as at an end of the range."""
        return self._found[_SAME].stretches > 0

    @property
    def are_filled(self) -> bool:
        """Whether they are rows between those of the sensor."""
        return self._filled.are_found

    def _is_open(self) -> bool:
        """Return whether a dropout may begin in the rows kept."""
        kept = self._kept.columns
        return bool((kept[:, 1:] == kept[:, :-1]).all(axis=0).any() or _are_same(kept).any())

    def _keep(self, samples: Samples, begin: int, decided: int) -> None:
        """Keep rows from a place on, of which the first are decided, for the next call."""
        self._kept = samples.kept(begin)
        self._decided, self._place, self._left_out = decided, -1, 0

    def _look(self, samples: Samples, *, is_end: bool) -> None:
        """Decide on the stretches of equal rows."""
        (every, every_ns), count = samples, samples.size
        changes = (every[:, 1:] != every[:, :-1]).any(axis=0)
        begins = np.append(0, np.flatnonzero(changes) + 1)
        ends = np.append(begins[1:], count)
        lengths = ends - begins
        if self._place >= 0:
            lengths[begins == self._place] += self._left_out
        same = _are_same(every[:, begins])
        size = np.abs(np.diff(every, axis=1)).max(axis=0)
        if (size > 0).any():
            self._step = min(self._step, float(size[size > 0].min()))
        last = count if is_end else count - CONTEXT
        chosen = (same | (lengths >= LONG)) & (begins >= self._decided) & (ends <= last)
        if chosen.any():
            stretches = _Stretches(begins[chosen], ends[chosen], lengths[chosen])
            self._decide(samples, size, stretches)
        if is_end:
            return
        undecided = begins[ends > last][0]
        begin = max(int(undecided) - CONTEXT, 0)
        left_out, place, tail = 0, -1, samples
        if (stop := int(ends[ends > last][0])) - undecided > 4 * CONTEXT:
            # The middle of a long stretch.
            left_out = stop - int(undecided) - 2 * CONTEXT
            place = int(undecided) - begin
            cut = slice(int(undecided) + CONTEXT, int(undecided) + CONTEXT + left_out)
            tail = Samples(np.delete(every, cut, axis=1), np.delete(every_ns, cut))
            left_out += self._left_out if self._place == undecided else 0
        self._keep(tail, begin, int(undecided) - begin)
        self._place, self._left_out = place, left_out

    def _decide(self, samples: Samples, size: Float64, stretches: _Stretches) -> None:
        """Count the stretches that are dropouts.

        `size`: the largest change of any axis from each row to the next
        """
        (every, every_ns), (begins, ends, lengths) = samples, stretches
        count, value = every.shape[1], every[:, begins]
        inside, goes_on = begins > 0, ends < count
        before, after = every[:, np.maximum(begins - 1, 0)], every[:, np.minimum(ends, count - 1)]
        usual, changing = _change_around(size, begins, ends)
        least = JUMP * np.maximum(usual, self._step)
        jump_in = np.where(inside, np.abs(before - value).max(axis=0), np.inf)
        jump_out = np.where(goes_on, np.abs(after - value).max(axis=0), np.inf)
        apart, jump = np.abs(before - after).max(axis=0), np.minimum(jump_in, jump_out)
        is_short = inside & goes_on & (apart < GOES_ON * jump)
        is_long = (lengths >= np.where(inside & goes_on, LONG, FROZEN_SAMPLES)) & (
            usual > (1 + EQUAL) * self._step
        )
        # A steady rotation without noise goes on as before.
        is_steady = is_short & (usual == 0) & (apart == 0) & ~changing & (jump > AT_REST)
        is_same, size_of = _are_same(value), np.abs(value).max(axis=0)
        jumps = is_short & (lengths < LONG) & (jump > least) | is_long & (jump > least / 2)
        jumps &= jump > SMALLEST_JUMP
        same = is_same & np.isfinite(jump) & (jumps & changing | is_steady)
        held = ~is_same & is_long & changing & (size_of < SMALLEST_RANGE)
        held &= (
            goes_on & (jump_out > np.maximum(least, SMALLEST_JUMP))
            | inside & goes_on & (jump > np.maximum(least / 2, SMALLEST_JUMP))
            | ~(inside & goes_on) & (size_of > AT_REST) & (lengths >= FROZEN_SAMPLES)
        )
        is_zero = size_of == 0
        nearby = np.maximum(
            *(
                np.where(known, np.abs(rate).max(axis=0), 0)
                for known, rate in ((inside, before), (goes_on, after))
            )
        )
        for kind, where in ((_HELD, held), (_SAME, same & ~is_zero), (_ZERO, same & is_zero)):
            if where.any():
                known, first = self._found[kind], int(where.argmax())
                found = _Found(
                    int(lengths[where].sum()),
                    int(np.count_nonzero(where)),
                    int(every_ns[begins[first]]),
                    int(every_ns[ends[first] - 1]),
                    float(value[0, first]),
                    float(nearby[where].max()),
                )
                self._found[kind] = found.after(known) if known.stretches else found

    def remarks(self, unit: Unit) -> Iterator[Remark]:
        """Yield a sentence for each kind of dropouts; there are no more samples."""
        if self._kept.size > 1:
            with np.errstate(over="ignore", invalid="ignore"):
                self._look(self._kept, is_end=True)
            self._kept = Samples()
        if self.are_filled:
            yield Remark("dropout", self._filled.text(unit))
            return
        name, scale = unit
        for kind, found in self._found.items():
            if not found.stretches:
                continue
            what = {
                _ZERO: "are exactly 0",
                _SAME: f"jump to {found.value / scale:.6g} {name}",
                _HELD: "stay the same",
            }[kind]
            if found.stretches == 1:
                times = f"from t = {found.first_ns} ns to t = {found.last_ns} ns"
                many = f" ({found.samples} samples)"
                where = times + many if found.samples > 1 else f"at t = {found.first_ns} ns"
            else:
                where = f"{found.stretches} times, {found.samples} samples in all, first at t = "
                where += f"{found.first_ns} ns"
            yield Remark(
                "dropout",
                f"all three rates {what} {where}, next to rates of up to "
                f"{found.nearby / scale:.4g} {name}: did the sensor drop out?",
            )


def _has_candidates(columns: Float64, extremes: Float64) -> bool:
    """Return whether rows may be a dropout, or the last may begin one."""
    x, y, z = columns
    same = x == y
    if np.count_nonzero(same) and (y[same] == z[same]).any():
        return True
    if _are_same(extremes[:, None])[0]:
        return True
    # A long stretch has two of these samples.
    few = columns[:, :: LONG // 2]
    last = columns[:, -2:]
    return bool(
        ((few[0, 1:] == few[0, :-1]) & (few[1, 1:] == few[1, :-1])).any()
        or (last[:, 0] == last[:, -1]).all()
    )


def _are_same(columns: Float64) -> Bool:
    """Return which rows have the same rate on all axes, but for the sign; shape ``(N,)``."""
    sizes = np.abs(columns)
    largest = sizes.max(axis=0)
    same: Bool = largest - sizes.min(axis=0) <= EQUAL * largest
    return same


def _change_around(size: Float64, begins: Intp, ends: Intp) -> tuple[Float64, Bool]:
    """Return the median change of neighbouring rows next to stretches, and whether most change.

    `size`: the largest change of any axis from each row to the next
    """
    near = np.arange(CONTEXT - 2)
    # From b - 1 to b, and from e - 1 to e, are the jumps.
    places = np.concatenate([begins[:, None] - 2 - near, ends[:, None] + near], axis=1)
    known = (places >= 0) & (places < len(size))
    changes = np.where(known, size[places.clip(0, max(len(size) - 1, 0))], np.nan)
    ordered, numbers = np.sort(changes, axis=1), known.sum(axis=1)
    usual = ordered[np.arange(len(begins)), np.maximum(numbers // 2, 0)]
    changing = (changes > 0).sum(axis=1) > CHANGING * numbers
    return np.where(numbers > 0, np.nan_to_num(usual), np.inf), changing
