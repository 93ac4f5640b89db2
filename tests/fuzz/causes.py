"""Likely causes of planted mistakes: wrong names, and remedies that do not deliver.

``python -m fuzz.causes [--first SEED] [--count N]`` (in ``tests/``): for each pair, the remedy that
is printed is applied, by the option that it names; the error is measured before and after.
"""

import math
import re
from dataclasses import replace

import numpy as np
from fuzz import seeds
from fuzz.planted import FINDINGS, KINDS, Pair, Source, pair
from make.places import SHARED_LOGS

import quatprop
from quatprop import AttitudeSeries, GyroSeries
from quatprop.base.errors import ComparisonError, QuatpropError
from quatprop.kinematics.quaternion import exp, multiply

PAIRS = 600

ALTERNATIVES = {
    "a wrong direction or JPL convention": {"conjugate"},
    "a wrong layout": {"layout", "layout-first"},
    "body rates treated as inertial rates": {"side"},
    "rates of the opposite sign": {"rate sign"},
    "swapped or reversed axes": {"axes"},
    "a time offset": {"time offset"},
    "clocks that differ": {"clock drift"},
    "rates that differ by a factor": {"scale"},
    "body frames that differ": {"body frame"},
    "reference frames that differ": {"reference frame"},
    "a constant rate": {"rate bias"},
    "a steady drift": {"drift"},
    "another integration rule": {"method"},
}
"""Causes that a sentence does not rule out -> its names."""


def rms_deg(one: Pair) -> float:
    """Return the RMS error of a pair as it is compared; infinite where it cannot be."""
    try:
        found = quatprop.compare(one.a.attitudes(), one.b.attitudes(), **one.options, tol=4)
    except QuatpropError:
        return math.inf
    return math.degrees(found.error_rad.rms)


def named(cause) -> list[set]:
    """Return the names that a cause has, with all those that its sentence leaves open."""
    cases = []
    for each in cause.chain if cause else []:
        names = {each.name}
        _, _, others = each.sentence.partition("does not distinguish it from ")
        for phrase, of_phrase in ALTERNATIVES.items():
            names |= of_phrase if phrase in others else set()
        if "or another integration rule" in each.sentence:
            names.add("method")
        cases.append(names)
    return cases


def is_true(names: set, true: set) -> bool:
    """Return whether one of some names, or all that it is made of, is true of a pair."""
    return any(set(parts(name)) <= true for name in names)


def parts(name: str) -> list[str]:
    """Return the mistakes that one name joins; a layout and the conjugate are one."""
    return re.split(r"(?<!layout)(?<!layout-first) and | and (?!conjugate)", name)


def mended(one: Pair, remedy: str):
    """Yield pairs in which a printed remedy was applied: one for each way that it offers."""
    first, _, rest = remedy.partition("; and also, ")
    for way in _ways(one, first):
        yield from mended(way, rest) if rest else [way]


def _ways(one: Pair, remedy: str):
    if found := re.match(r"(align|time_offset)='([^']*)'", remedy):
        key, value = found.groups()
        assert one.options.get(key) != value, f"{key}={value} is on already"
        yield replace(one, options={**one.options, key: value})
        return
    for clause in remedy.split("; "):
        found = re.search(r"\bif (?:it is )?([AB])\b|B\b", clause)
        sides = "ab" if found is None else (found[1] or "b").lower()
        for side in sides:
            source = _mended(getattr(one, side), clause, one)
            if source is not None:
                yield replace(one, **{side: source})
                break


def _mended(source, clause, one):  # noqa: PLR0911, PLR0912  # one kind of remedy after another
    """Return a source to which a clause of a remedy was applied; None: it does not apply."""
    number = r"([-+\d.e]+)"
    if "read it with" in clause:
        given = dict(re.findall(r"(from_\w+)='([^']*)'", clause))
        if len(given) > 1 and " or from_convention" in clause:
            given.pop("from_convention")
        assert not given.items() <= source.read.items(), f"{given} is on already"
        return replace(source, read={**source.read, **given})
    if found := re.search(
        f"turn B back by {number}, {number}, {number} deg/h.*(body|reference)", clause
    ):
        series = source.attitudes()
        seconds = (series.t_ns - series.t_ns[0])[:, None] / 1e9
        turn = exp(-seconds * np.radians(np.array(found.groups()[:3], float) / 3600))
        pair = (series.wxyz, turn) if found[4] == "body" else (turn, series.wxyz)
        return Source(series=AttitudeSeries(series.t_ns, multiply(*pair)))
    if found := re.search(f"add {number} ms to B's timestamps.* {number} ppm", clause):
        series = source.attitudes()
        since = series.t_ns - series.t_ns[0]
        added = float(found[1]) * 1e6 + float(found[2]) * 1e-6 * since
        t_ns = series.t_ns + np.round(added).astype(np.int64)
        return Source(series=AttitudeSeries(t_ns, series.wxyz))
    if re.search(r"omit \d", clause):
        errors = quatprop.compare(one.a.attitudes(), one.b.attitudes(), tol=4, **one.options)
        keep = (
            errors.errors <= np.sort(errors.errors)[-1 - int(re.search(r"omit ([\d]+)", clause)[1])]
        )
        series = one.b.attitudes()
        kept = np.isin(series.t_ns, errors.t_ns[keep])
        return Source(series=series[kept])
    if source.rates is None:
        return None
    rate, options = source.rates.rate, dict(source.propagate)
    if found := re.search(f"multiply its rates by {number}", clause):
        rate = rate * float(found[1])
    elif found := re.search(r"read its rates as ([-xyz]+), ([-xyz]+), ([-xyz]+)", clause):
        rate = np.stack(
            [rate[:, "xyz".index(n[-1])] * (-1) ** ("-" in n) for n in found.groups()], 1
        )
    elif "rate_unit" in clause:
        rate = np.radians(rate) if np.abs(rate).max() > 30 else np.degrees(rate)
    elif "rates=" in clause:
        wanted = re.findall("rates='([a-z]+)'", clause)
        options["rates"] = wanted[0] if wanted else "body" if "rates" in options else "inertial"
    else:
        found = re.search(r"propagated with method (\w+)", clause)
        if found and options.get("method") != found[1]:
            return None
        given = dict(re.findall(r"(method|mount|bias)='([^']*)'", clause))
        if not given or any(options.get(key) == value for key, value in given.items()):
            return None
        options |= given
    return replace(source, rates=GyroSeries(source.rates.t_ns, rate), propagate=options)


def judge(one: Pair):
    """Return the verdict on the names, sentences on what is wrong, and the cause."""
    a, b = one.a.attitudes(), one.b.attitudes()
    try:
        found = quatprop.compare(a, b, **one.options)
    except ComparisonError as error:
        return "refused", [str(error)], None
    cause = found.likely_cause
    cases = named(cause)
    is_wrong = not all(is_true(names, one.true) for names in cases)
    right = any(one.planted & set(parts(name)) for names in cases for name in names)
    faults = list(_undelivered(one, cause, math.degrees(found.error_rad.rms)))
    verdict = "wrong" if is_wrong else "right" if right else "named" if cases else "none"
    return verdict, faults, cause


def _undelivered(one: Pair, cause, before: float):
    """Yield the cases in which a remedy does not do what the cause promises."""
    for each in cause.chain if cause else []:
        after = math.degrees(each.rms_after)
        try:
            ways = list(mended(one, each.remedy))
        except AssertionError as error:
            yield f"{each.name}: {error}"
            return
        measured = [rms_deg(way) for way in ways]
        if not before <= 1.1 * math.degrees(each.rms_before) + 1e-9:
            yield f"{each.name}: before {math.degrees(each.rms_before):.4g} is {before:.4g}"
        if not measured:
            yield f"{each.name}: no way to apply {each.remedy!r}"
            return
        for now in measured:
            most = min(1.1 * after + 0.03 * before, 0.5 * before) + 1e-9
            if not now <= most:
                yield f"{each.name}: {before:.4g} to {after:.4g} is to {now:.4g} ({each.remedy})"
        one, before = ways[0], measured[0]


def judged(number):
    """Return what is planted and the verdict on it; what is wrong, or does not deliver."""
    one = pair(number, SHARED_LOGS if SHARED_LOGS.is_dir() else None)
    verdict, faults, cause = judge(one)
    kind = KINDS[number % len(KINDS)]
    counted = f"{kind}{' (finding)' * (kind in FINDINGS)}: {verdict}"
    if verdict != "wrong" and not faults:
        return counted, None
    sentence = cause and f"{cause.name}: {cause.sentence[:110]}"
    return counted, "\n        ! ".join([f"{verdict:8}{one.title}\n        {sentence}", *faults])


if __name__ == "__main__":
    seeds.main(__doc__, judged, PAIRS)
