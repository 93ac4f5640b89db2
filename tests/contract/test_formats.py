"""Every format keeps its samples to the bit, wherever the log is and whatever is read."""

import io
import re
import shutil

import pytest
from make.commands import refused, run
from make.formats import FORMATS, SAMPLES, samples
from make.reading import rates

import quatprop
from quatprop.base.errors import AmbiguousTopicError, UnsupportedLogError
from quatprop.readers import range_readers
from quatprop.readers.open_log import open_log
from quatprop.stores.kinds import READERS

FILES = [name for name in FORMATS if not name.endswith("ros2")]
every_format = pytest.mark.parametrize("name", FORMATS)
every_file = pytest.mark.parametrize("name", FILES)


def held(name, count=SAMPLES, first=0):
    """Return samples as a format holds them."""
    return FORMATS[name].holds(samples(count, first))


def assert_same(found, expected):
    """Compare stamps and rates to the bit."""
    assert found.t_ns.tolist() == expected.t_ns.tolist()
    assert found.rate.tobytes() == expected.rate.tobytes()


@every_format
@pytest.mark.parametrize("is_remote", [False, True])
def test_a_log_has_its_samples_to_the_bit(logs, name, is_remote):
    """Stamps and rates are those that were written, nothing is lost, at an address as well."""
    path = logs / name
    _, found, losses = rates(path.as_uri() if is_remote else path)
    assert_same(found, held(name))
    assert losses == []


@pytest.mark.parametrize("name", [name for name in FORMATS if FORMATS[name].topics])
def test_each_of_several_topics_has_its_samples(tmp_path, name):
    """None is taken where it is not said which; each is read by its name."""
    form, path = FORMATS[name], tmp_path / name
    several = [held(name), held(name, 150, 20)]
    form.write(path, *several)
    first, second = form.topics
    with pytest.raises(AmbiguousTopicError, match=f"'{first}', '{second}'"):
        rates(path)
    for topic, expected in zip(form.topics, several, strict=True):
        source, found, losses = rates(path, topic=topic)
        assert source.name == topic
        assert_same(found, expected)
        assert losses == []
    with open_log(path) as log:
        counts = {channel.topic: channel.count for channel in log.channels()}
        assert [counts[topic] or 0 for topic in form.topics] in ([200, 150], [0, 0])


@every_format
@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
def test_a_range_of_time_has_the_attitudes_of_its_samples(logs, monkeypatch, name):
    """By times and by spans; where the log has an index, the rest is not read."""
    monkeypatch.setattr(range_readers, "MARGIN_NS", 50_000_000)
    series = held(name)
    first, last = series.t_ns[[0, -1]]
    for low, high, start, end in (
        (first + 600_000_000, first + 900_000_000, "+600ms", "+900ms"),
        (series.t_ns[80], series.t_ns[99], int(series.t_ns[80]), int(series.t_ns[99])),
        (last - 300_000_000, last, "-300ms", None),
        (first, first + 250_000_000, None, "+250ms"),
    ):
        found = quatprop.propagate(logs / name, start=start, end=end)
        expected = series[(series.t_ns >= low) & (series.t_ns <= high)]
        assert found.t_ns.tolist() == expected.t_ns.tolist()
        assert found.wxyz.tobytes() == quatprop.propagate(expected).wxyz.tobytes()
        assert (found.report.correction.part is not None) == FORMATS[name].indexed


@every_file
def test_a_log_is_read_from_a_pipe(logs, tmp_path, name):
    """Its content tells the kind, or the user; the attitudes are those of the file."""
    _, suffix, *packed = name.split(".")
    kinds = {"jsonl": "jsonl", "mat": "matlab"} | ({suffix: suffix} if packed else {})
    kind = [f"--from={kinds[suffix]}"] if suffix in kinds else []
    stdin = io.BufferedReader(io.BytesIO((logs / name).read_bytes()))
    piped = run("propagate", "-", "-o", "-", "-q", *kind, input=stdin, code=0)
    run("propagate", logs / name, "-o", tmp_path / "out.csv", code=0)
    assert piped.stdout_bytes == (tmp_path / "out.csv").read_bytes()


@every_format
def test_a_log_without_samples_is_refused_in_a_sentence(tmp_path, name):
    """Whether it has the structure of its format, or not one byte."""
    path = tmp_path / name
    FORMATS[name].write(path, held(name, 0))
    for is_without_a_byte in (False, True):
        if is_without_a_byte:
            if path.is_dir():
                shutil.rmtree(path)
                path.mkdir()
            else:
                path.write_bytes(b"")
        for command in (["propagate", path, "-o", tmp_path / "out.csv"], ["convert", path, "-"]):
            assert refused(*command).startswith(f"Error: {path}: ")
    assert list(tmp_path.iterdir()) == [path]


@every_file
def test_what_cat_makes_of_two_logs_is_read_or_told(logs, tmp_path, name):
    """Never one log for both without a word, never two clocks, topics or tables mixed."""
    form, first, second = FORMATS[name], held(name), held(name, 100, SAMPLES)
    path = tmp_path / name
    form.write(path, second)
    behind = path.read_bytes()
    path.write_bytes((logs / name).read_bytes() + behind)
    if form.joined == "refused":
        with pytest.raises(UnsupportedLogError, match="another file begins in it at byte "):
            rates(path)
        return
    _, found, losses = rates(path)
    if form.joined == "read":
        assert_same(found, quatprop.GyroSeries.joined([first, second]))
        assert losses == []
    else:
        assert_same(found, first)
        (loss,) = losses
        said = rf"{len(behind)} bytes follow (the|its) \w+ and are not read; was another joined "
        assert re.match(said, loss.reason)


def test_every_kind_of_log_has_a_row(logs):
    """Those of rates: of trajectories, which hold attitudes alone, there is no log here."""
    kinds = set()
    for name in FORMATS:
        with open_log(logs / name) as log:
            kinds.add(log.kind)
    assert kinds == set(READERS) - {"tum", "kitti"}
