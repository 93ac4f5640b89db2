"""Propagate one log of a batch, in whatever process or on whatever machine an executor runs it."""

from __future__ import annotations

import os
import pickle
import time
from functools import lru_cache, partial
from typing import TYPE_CHECKING

from quatprop.base import __version__
from quatprop.base.errors import (
    LogError,
    NoRatesError,
    QuatpropError,
    ReplacedError,
    UnknownFormatError,
    UnsupportedLogError,
    as_user_error,
)
from quatprop.base.places import is_address
from quatprop.base.provenance import Digest, digest_of
from quatprop.base.text import plain, spelled, spelling
from quatprop.propagation.job import ATTEMPTS, run
from quatprop.stores.objects import is_transient
from quatprop.stores.remote import upload
from quatprop.stores.temp_files import temp_folder
from quatprop.tools.batch.manifest import ManifestEntry
from quatprop.tools.batch.planning import BatchResult, BatchSettings, failed, with_topic
from quatprop.tools.batch.tasks import BatchTask, absolute, origin_of_read
from quatprop.writers.targets import refuse_outside

if TYPE_CHECKING:
    from collections.abc import Sequence

    from quatprop.propagation.report import RunReport


MAX_PAUSE_S = 30.0
"""Maximum pause before a retry, s."""


def propagate_log(task: BatchTask, settings: BatchSettings) -> BatchResult:
    """Propagate one log; errors are returned as results."""
    with spelling(settings.spelling):
        return _propagated_log(task, settings)


def _propagated_log(task: BatchTask, settings: BatchSettings) -> BatchResult:
    began = time.perf_counter()
    attempt = 0
    while True:
        try:
            result = _propagate_task(task, settings)
        except QuatpropError as error:
            if is_transient(error) and attempt < settings.retries:
                time.sleep(min(2.0**attempt, MAX_PAUSE_S))
                attempt += 1
                continue
            is_other = isinstance(error, NoRatesError | UnknownFormatError)
            text = _sentence(task, error)
            if is_other and task.standing == "done":
                text += "; it was done in an earlier batch: is it damaged?"
            result = failed(
                task, text, "no rates" if is_other and task.standing == "table" else "failed"
            )
        except Exception as error:
            if (user_error := as_user_error(error)) is None:
                raise
            result = failed(task, _sentence(task, user_error))
        break
    seconds = time.perf_counter() - began
    entry = result.entry._replace(seconds=seconds, options=settings.options)
    return result._replace(entry=entry)


def _sentence(task: BatchTask, error: QuatpropError) -> str:
    """Return the sentence of an error, with the log and the topic if it does not name the log."""
    shown, label = plain(task.shown), plain(task.label)
    if isinstance(error, LogError) and plain(error.path) == shown:
        return f"{label}: {error.reason}"
    return error.text if shown in error.text else f"{label}: {error.text}"


def _propagate_task(task: BatchTask, settings: BatchSettings) -> BatchResult:
    """Propagate one log; an output for an object store is written locally, then uploaded."""
    if task.refused:
        raise UnsupportedLogError(task.shown, task.refused)
    output = settings.output_of(task)
    if not is_address(output):
        refuse_outside(output, settings.folder)
        os.makedirs(os.path.dirname(output) or ".", exist_ok=True)
        return _propagated(task, settings, output)
    temp = temp_folder()
    try:
        local = temp.path / os.path.basename(task.name)
        result = _propagated(task, settings, str(local))
        upload(local, output)
    finally:
        temp.remove()
    return result


def _propagated(task: BatchTask, settings: BatchSettings, path: str) -> BatchResult:
    """Propagate one log into a local file."""
    job = settings.job
    names, output = partial(display_names, task), job.output._replace(path=path)
    job = with_topic(job, task.topic)._replace(log=task.path, display_names=names, output=output)
    for _ in range(ATTEMPTS):
        origin = task.origin if is_address(task.path) else task.origin_now()
        report = run(job, summary=False)
        log = report.source.digest
        # For a log in a store, the reader has verified that it was not replaced.
        if is_address(task.path):
            break
        log = log if log.sha256 else digest_of(task.path)
        if origin == task.origin_now():
            break
    else:
        raise ReplacedError(
            f"{plain(task.path)}: it was written to while it was read; try again when it is "
            "complete"
        )
    origin = origin or origin_of_read(task.path, log)
    entry = _entry(task, report, log, digest_of(path))._replace(origin=origin)
    if settings.expect is not None:
        # Not needed by batches without expectations.
        from quatprop.tools.check.expect import unmet

        reasons = unmet([task.path], job.settings, settings.expect)
        entry = entry._replace(unmet=tuple(reasons))
    json = report.as_json() if settings.reports else None
    return BatchResult(entry, losses=report.losses, report=json)


def display_names(task: BatchTask, paths: Sequence[str]) -> list[str]:
    """Return the names of a log and of other inputs in its output, the same on any machine.

    Inputs below the root have their path there, others their file name, with as many folders as
    make it unique.
    """
    above = os.path.join(absolute(task.root), "")
    full = [absolute(path) for path in paths]
    inside = [path.startswith(above) for path in full]
    places = [path.removeprefix(above).replace(os.sep, "/") for path in full]
    for depth in range(1, 2 + max(place.count("/") for place in places)):
        tails = ("/".join(place.split("/")[-depth:]) for place in places)
        names = [each[not own] for own, *each in zip(inside, places, tails, strict=True)]
        if len({*names}) == len({*full}):
            break
    return [task.log, *names[1:]]


def _entry(task: BatchTask, report: RunReport, log: Digest, output: Digest) -> ManifestEntry:
    result = report.result
    return ManifestEntry(
        state="data lost" if report.data_lost else "done",
        root=absolute(task.root),
        log=task.log,
        output=task.name,
        samples=result.samples,
        rows=result.rows,
        span_s=result.span_s,
        sample_rate_hz=result.sample_rate_hz,
        method=report.convention.method,
        final_wxyz=tuple(map(float, result.final_wxyz)),
        remarks=tuple(map(spelled, report.remarks)),
        losses=tuple(f"{loss.place}: {loss.reason}" for loss in report.losses),
        log_bytes=log.bytes,
        log_sha256=log.sha256,
        log_etag=log.etag,
        output_bytes=output.bytes,
        output_sha256=output.sha256,
        attitudes_crc32=result.attitudes_crc32,
    )


class Call:
    """Propagates a log when it is unpickled: where the package is missing, only the call fails.

    `packed`: pickled settings, and versions that the worker must have
    """

    def __init__(self, task: BatchTask, packed: bytes) -> None:
        self._arguments = task, packed

    def __reduce__(self) -> tuple[object, ...]:
        return propagate_there, self._arguments


@lru_cache(1)
def _unpacked(packed: bytes) -> tuple[BatchSettings, dict[str, str]]:
    return pickle.loads(packed)  # type: ignore[no-any-return]  # noqa: S301


@lru_cache(1)
def versions() -> dict[str, str]:
    """Return the versions, here, of what decides the bytes of an output."""
    from importlib.metadata import version

    return {"quatprop": __version__, **{name: version(name) for name in ("numpy", "pyarrow")}}


def propagate_there(task: BatchTask, packed: bytes) -> BatchResult:
    """Propagate one log where an executor runs it, by the same versions as here."""
    settings, wanted = _unpacked(packed)
    for name, there in wanted.items():
        if (here := versions()[name]) != there:
            reason = f"its worker has {name} {here}, not {there}; install the same version"
            return failed(task, f"{plain(task.shown)}: {reason}")
    return propagate_log(task, settings)
