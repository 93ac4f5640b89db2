"""Draw files into a picture: all of ``quatprop plot``."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Self

from quatprop.base.errors import (
    DamagedLogError,
    NoAttitudesError,
    NoRatesError,
    NoSuchTopicError,
    NothingToDrawError,
    SeriesError,
    UndeclaredError,
    UsageError,
)
from quatprop.base.places import without_secret
from quatprop.base.provenance import entry_of
from quatprop.base.rendering import (
    Row,
    count_text,
    file_names,
    instant_text,
    loss_lines,
    samples_text,
    source_text,
)
from quatprop.base.text import Remark, Setting, plain, spelled
from quatprop.base.times import duration_text
from quatprop.comparison.comparison import compare
from quatprop.kinematics.conventions import HAMILTON
from quatprop.kinematics.series import AttitudeSeries, GyroSeries
from quatprop.kinematics.time_series import blocks
from quatprop.propagation.attitude_input import AttitudeInput, RecordedAttitudes, load_attitudes
from quatprop.propagation.rate_stream import AS_RECORDED, RateStream
from quatprop.propagation.recording import ReadInput, Recording, open_recording
from quatprop.readers.signal import AttitudeSignal, RateSignal
from quatprop.settings.quantities import RATES
from quatprop.settings.reading import (
    ONE_SERIES,
    READ_RATES,
    AttitudeSelection,
    GyroCorrection,
    RateSelection,
)
from quatprop.stores.objects import split_topic
from quatprop.timeline.stamps import StampChecks
from quatprop.tools.plot.contents import ComparedFile, error_page, errors_over_time
from quatprop.tools.plot.figure import STYLE, Style
from quatprop.tools.plot.page import PictureFile
from quatprop.tools.plot.picture import (
    SIGMA_BAND,
    Accumulator,
    AttitudeAccumulator,
    Page,
    Picture,
    PlottedFile,
    RateAccumulator,
    picture,
    topic_text,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from contextlib import AbstractContextManager

    from quatprop.base.errors import Loss
    from quatprop.comparison.result import Comparison
    from quatprop.settings.command_options import ComparisonSettings
    from quatprop.timeline.counts import Counts


# Read files for a picture in one pass and in constant memory.


OF_ATTITUDES = [name for name in ONE_SERIES if name not in READ_RATES]
"""Settings for attitudes only."""


class View(NamedTuple):
    """The selection of what is drawn.

    `kind`: a key of :data:`quatprop.stores.kinds.READERS`; None: detected from content and suffix
    `show`: None: the rates of a file, or its attitudes if it has no rates
    `components`: draw the components of quaternions instead of angles
    `unwrap`: draw angles beyond half a turn
    `part`: start and end of the part to draw, ends included
    """

    kind: str | None = None
    show: Literal["rates", "attitude"] | None = None
    rates: RateSelection = RateSelection()
    attitudes: AttitudeSelection = AttitudeSelection()
    components: bool = False
    unwrap: bool = False
    part: GyroCorrection = GyroCorrection()

    @classmethod
    def from_settings(cls, values: Mapping[str, Any]) -> Self:
        """Return the selection from the values of settings and of `show`, `components`, `unwrap`.

        Any setting for attitudes selects attitudes.
        """
        components, unwrap = bool(values.get("components")), bool(values.get("unwrap"))
        if components and unwrap:
            raise UsageError(
                f"{Setting('unwrap')} cannot be combined with {Setting('components')}, which have "
                "no turns"
            )
        show = values.get("show")
        for name in ("components", "unwrap", *OF_ATTITUDES):
            if values.get(name):
                if show == "rates":
                    raise UsageError(f"{Setting(name)} requires {Setting('show', 'attitude')}")
                show = "attitude"
        return cls(
            kind=values.get("kind"),
            show=show,
            rates=RateSelection.from_settings(values),
            attitudes=AttitudeSelection.from_settings(values),
            components=components,
            unwrap=unwrap,
            part=GyroCorrection(start=values.get("start"), end=values.get("end")),
        )

    def opened(self, name: str) -> AbstractContextManager[Recording]:
        """Open a file, ``LOG`` or ``LOG:TOPIC``, as a context manager."""
        return open_recording([name], self.rates, self.kind)

    def attitude_input(self, name: str) -> AttitudeInput:
        """Return the attitudes of a file, ``LOG`` or ``LOG:TOPIC``."""
        path, topic = split_topic(name, self.attitudes.topic)
        return AttitudeInput(path, self.kind, replace(self.attitudes, topic=topic), drop=True)


class FileView(NamedTuple):
    """The content of one file in a picture.

    `plotted`: its reduced samples, labelled with its path
    `source`: the topic, or the columns
    `meaning`: unit and clock of its numbers, or convention and method
    `remarks`: remarks for the reader
    """

    plotted: PlottedFile
    source: str
    meaning: str
    samples: str
    facts: tuple[Row, ...]
    remarks: tuple[Remark, ...]
    losses: tuple[Loss, ...]

    @property
    def about(self) -> ReadInput:
        """Its losses and remarks."""
        return ReadInput(self.plotted.label, self.losses, self.remarks)


DRAWN_AS = {
    False: "yaw, pitch and roll, q = q_z(yaw) q_y(pitch) q_x(roll), deg",
    True: "components, with the sign (q or -q) nearest to the previous row",
}
"""Whether components are drawn -> description of the drawing."""


def view_file(name: str, view: View) -> FileView:
    """Read a file for a picture.

    `name`: a log or a table, possibly ``LOG:TOPIC``, or ``"-"`` for CSV on stdin
    """
    with view.opened(name) as recording:
        signal = _choose(recording, view)
        if isinstance(signal, RateSignal):
            return _view_rates(recording, signal, view)
        return _view_attitudes(recording, signal, view)


def view_series(name: str, series: GyroSeries | AttitudeSeries, view: View) -> FileView:
    """Return the content of a series in memory."""
    if not len(series):
        raise SeriesError(f"{name} has no rows to draw")
    holds = "rates" if isinstance(series, GyroSeries) else "attitude"
    if view.show not in {None, holds}:
        raise UsageError(f"{name} has no {view.show} to show")
    drawn: Accumulator
    shown: Iterator[GyroSeries] | Iterator[AttitudeSeries]
    if isinstance(series, GyroSeries):
        drawn = rates = RateAccumulator("rad/s")
        shown = rates.passing(series[rows] for rows in blocks(len(series)))
    else:
        drawn = attitudes = AttitudeAccumulator(
            components=view.components,
            unwrap=view.unwrap,
            has_sigmas=series.covariance is not None,
        )
        shown = attitudes.passing(series[rows] for rows in blocks(len(series)))
    stamps = StampChecks(name)
    deque(stamps.observe(batch.t_ns for batch in shown), maxlen=0)
    counts = stamps.counts
    plotted = PlottedFile(name, (drawn.group(counts.gap_limit_ns),))
    samples = samples_text(counts.samples_used, counts.span_ns, counts.median_dt_ns)
    remarks = tuple(_irregularities(counts))
    return FileView(plotted, "", "in memory", samples, (), remarks, ())


def _choose(recording: Recording, view: View) -> RateSignal | AttitudeSignal:
    """Return the rates to draw, or the attitudes if there are none."""
    attitudes = partial(recording.attitude_signal, view.attitudes)
    if view.show == "attitude":
        return attitudes()
    try:
        return recording.rate_signal()
    except (DamagedLogError, NoRatesError, NoSuchTopicError, UndeclaredError) as error:
        if view.show == "rates":
            raise
        try:
            return attitudes()
        except (NoAttitudesError, NoSuchTopicError, UndeclaredError) as other:
            if isinstance(error, NoRatesError) and isinstance(other, NoAttitudesError):
                raise NothingToDrawError(
                    error.path, error.seen, error.what, error.packed
                ) from error
            if isinstance(other, UndeclaredError):
                raise
            raise error from other


def _view_rates(recording: Recording, source: RateSignal, view: View) -> FileView:
    drawn = RateAccumulator(source.unit)
    stream = RateStream(recording, AS_RECORDED._replace(correction=view.part), source)
    deque(stream.read(used=drawn.passing), maxlen=0)
    counts = stream.counts
    convention = "rates as recorded, in the axes of the sensor; nothing subtracted"
    about = [("convention", convention), ("rate", f"{source.field} in {source.unit}")]
    last = ("largest rate", f"{counts.max_rate / RATES[source.unit]:.6g} {source.unit}")
    return FileView(
        plotted=_plotted(recording, source, drawn, counts),
        source=source.name,
        meaning=f"body rates as recorded, {source.unit}, {source.clock} clock",
        samples=samples_text(counts.samples_used, counts.span_ns, counts.median_dt_ns),
        facts=(*_facts(recording, source, about, counts), last),
        remarks=tuple(stream.remarks()),
        losses=stream.losses,
    )


def _view_attitudes(recording: Recording, source: AttitudeSignal, view: View) -> FileView:
    drawn = AttitudeAccumulator(
        components=view.components, unwrap=view.unwrap, has_sigmas=source.may_have_covariances
    )
    wanted = AttitudeInput(recording.name, None, view.attitudes, part=view.part)
    attitudes, stamps = RecordedAttitudes(recording, wanted), StampChecks(recording.name)
    counts = stamps.counts
    rows = attitudes.rows(covariances=source.may_have_covariances)
    shown = drawn.passing(AttitudeSeries(*row) for row in rows)
    deque(stamps.observe(batch.t_ns for batch in shown), maxlen=0)
    if not counts.samples_used:
        raise attitudes.nothing()
    remarks = [
        *source.remarks,
        *_irregularities(counts),
        *attitudes.range.remarks(),
        *recording.remarks,
    ]
    if drawn.invalid:
        invalid = count_text(drawn.invalid, "invalid quaternion")
        text = f"{invalid} (zero, absent or not finite): not drawn"
        remarks.append(Remark("invalid-quaternions", text))
    method = plain(entry_of(source.provenance, "convention", dict).get("method") or "")
    form = "components, sign continuous" if view.components else "zyx angles"
    form += f" ({SIGMA_BAND})" if drawn.knows_sigmas else ""
    propagated = f", propagated with method {method}" if method else ""
    stored = f"{source.meaning.convention} {source.meaning.direction}"
    about = [
        ("convention", HAMILTON.description),
        ("drawn as", DRAWN_AS[view.components]),
        ("attitude", f"{source.field}, stored {source.layout}, {stored}"),
        *([("method", method)] if method else []),
    ]
    last = ("norm error", f"at most {drawn.norm_error:.3g}")
    return FileView(
        plotted=_plotted(recording, source, drawn, counts),
        source=source.name,
        meaning=f"Hamilton q, body to reference, as {form}{propagated}, {source.clock} clock",
        samples=samples_text(counts.samples_used, counts.span_ns, counts.median_dt_ns),
        facts=(*_facts(recording, source, about, counts), last),
        remarks=tuple(remarks),
        losses=recording.losses,
    )


def _plotted(
    recording: Recording, source: RateSignal | AttitudeSignal, drawn: Accumulator, counts: Counts
) -> PlottedFile:
    path = without_secret(recording.name)
    shown = topic_text(recording.kind, source.name, source.type_name)
    return PlottedFile(path, (drawn.group(counts.gap_limit_ns),), shown)


def _facts(
    recording: Recording,
    source: RateSignal | AttitudeSignal,
    about: Iterable[Row],
    counts: Counts,
) -> Iterator[Row]:
    yield "file", f"{without_secret(recording.name)} ({recording.kind})"
    yield "source", source_text(source.name, source.type_name)
    yield "clock", source.clock
    yield from about
    yield "samples", samples_text(counts.samples_used, counts.span_ns, counts.median_dt_ns)
    for label, t_ns in (("first", counts.first_ns), ("last", counts.last_ns)):
        yield label, f"{instant_text(t_ns or 0)} ({t_ns} ns)"
    if counts.median_dt_ns is not None and counts.max_dt_ns is not None:
        median, longest = duration_text(counts.median_dt_ns), duration_text(counts.max_dt_ns)
        yield "interval", f"median {median}, longest {longest}"


def _irregularities(counts: Counts) -> Iterator[Remark]:
    """Yield a sentence for each kind of irregularity."""
    limit = duration_text(counts.gap_limit_ns or 0)
    longest = duration_text(counts.max_dt_ns or 0)
    for code, event, noun, details in (
        ("gaps", counts.gaps, "gap", f" longer than {limit}, the longest {longest}: shaded"),
        ("repeated-stamps", counts.duplicates, "repeated timestamp", ""),
        ("stamp-outliers", counts.outliers, "timestamp outlier", counts.outliers.cause),
        ("stamps-back", counts.backwards, "non-monotonic timestamp", ""),
        ("nonfinite-rates", counts.nonfinite, "non-finite rate", " (not drawn)"),
    ):
        if event.count:
            text = f"{count_text(event.count, noun)}{details}, first at {event.first_ns} ns"
            yield Remark(code, text)


def plot(  # noqa: PLR0913  # what the command line gives
    names: Sequence[str],
    view: View,
    output: str,
    reference: AttitudeInput | None,
    settings: ComparisonSettings,
    *,
    style: Style = STYLE,
    command: str = "",
) -> tuple[list[str], Page, list[ReadInput]]:
    """Draw files into a picture; returns lines on them, the page, and remarks on each.

    `names`: ``LOG`` or ``LOG:TOPIC``, at least one; ``"-"`` is CSV on stdin
    `reference`: draw the error of each file against this series; None to draw the files
    """
    files = [split_topic(name, view.rates.topic)[0] for name in names]
    inputs = [*files, None if reference is None else reference.path]
    with PictureFile(output, inputs, style=style, command=command) as target:
        if reference is None:
            views = [view_file(name, view) for name in names]
            page = _page(views)
            named = zip(page.tables, views, strict=True)
            lines = [f"{name}: {one.samples}" for (name, _), one in named]
            inputs_read = [one.about for one in views]
        else:
            page, inputs_read = _error_page(
                [view.attitude_input(name) for name in names], reference, settings
            )
            lines = list(page.lead)
        target.commit(page)
    return lines, page, inputs_read


def read_picture(
    sources: Sequence[str | GyroSeries | AttitudeSeries],
    view: View,
    reference: str | AttitudeSeries | None,
    settings: ComparisonSettings,
) -> tuple[Picture, list[ReadInput]]:
    """Return a picture of files and of series, and the remarks and losses of each.

    `reference`: draw the error of each against these attitudes
    """
    labels = [
        one if isinstance(one, str) else f"series {number}" for number, one in enumerate(sources, 1)
    ]
    if reference is None:
        views = [
            view_file(one, view) if isinstance(one, str) else view_series(label, one, view)
            for one, label in zip(sources, labels, strict=True)
        ]
        return _page(views).picture, [one.about for one in views]
    truth, inputs_read = _attitudes(reference, View())
    errors = []
    for one, name in zip(sources, file_names((label, "") for label in labels), strict=True):
        series, about = _attitudes(one, view)
        comparison = compare(series, truth, settings)
        errors.append(errors_over_time(name, comparison))
        inputs_read += [*about, _about(name, comparison)]
    return picture(errors), inputs_read


def _about(name: str, comparison: Comparison) -> ReadInput:
    """Return the remarks on a series that was compared."""
    return ReadInput(name, (), comparison.remarks, comparison.omitted_duplicates)


def _attitudes(source: object, view: View) -> tuple[AttitudeSeries, list[ReadInput]]:
    """Return attitudes of a file or in memory, with the remarks and losses of the file."""
    if isinstance(source, str):
        loaded = load_attitudes(view.attitude_input(source))
        return loaded.series, [loaded.about]
    if not isinstance(source, AttitudeSeries):
        raise SeriesError(f"Expected attitudes, got {type(source).__name__}")
    return source, []


def _page(views: list[FileView]) -> Page:
    """Return the page on files, without a reference."""
    several = len(views) > 1
    names = file_names((view.plotted.label, view.source) for view in views)
    files = [
        # The detail contains the topic.
        view.plotted._replace(label=name.removesuffix(f" {view.source}"))
        for view, name in zip(views, names, strict=True)
    ]
    meanings = dict.fromkeys(view.meaning for view in views)
    facts = ("; ".join(meanings), "; ".join(dict.fromkeys(view.samples for view in views)))
    return Page(
        title=f"{len(views)} files: {', '.join(names)}" if several else files[0].name,
        facts=facts,
        lead=facts,
        picture=picture(files),
        warnings=tuple(
            f"{name}: {remark}" if several else remark
            for name, view in zip(names, views, strict=True)
            for remark in (*map(spelled, view.remarks), *loss_lines(view.losses))
        ),
        tables=[(file.name, view.facts) for file, view in zip(files, views, strict=True)],
    )


def _error_page(
    files: Sequence[AttitudeInput], wanted: AttitudeInput, settings: ComparisonSettings
) -> tuple[Page, list[ReadInput]]:
    """Return the page on the errors of files, with the remarks on them and on the reference."""
    reference = load_attitudes(wanted)
    operands = [load_attitudes(one) for one in files]
    names = file_names((one.input.path, one.signal.name) for one in (*operands, reference))
    compared = [
        ComparedFile(name, operand, compare(operand.series, reference.series, settings))
        for name, operand in zip(names, operands, strict=False)
    ]
    page = error_page(compared, names[-1], reference)
    inputs_read = [one.about for one in (reference, *operands)]
    return page, inputs_read + [_about(file.name, file.comparison) for file in compared]
