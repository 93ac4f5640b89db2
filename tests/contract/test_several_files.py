"""Several files of one recording are one log, whatever their format."""

import json
import subprocess
from itertools import pairwise

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from make.commands import refused, run
from make.formats import FORMATS, SAMPLES, samples
from make.ros import imu_messages, write_messages

import quatprop
from quatprop.base.errors import TimelineError, UsageError
from quatprop.kinematics.propagate import attitudes
from quatprop.kinematics.quaternion import geodesic_angle

CUTS = (0, 70, 130, SAMPLES)


def parts_of(folder, name):
    """Write the samples in three files, the last of which comes first by name."""
    parts = []
    for number, (first, end) in enumerate(pairwise(CUTS)):
        part = folder / f"{9 - number}" / name
        part.parent.mkdir()
        FORMATS[name].write(part, samples(end - first, first))
        parts.append(part)
    return parts[::-1]


@pytest.mark.parametrize("name", FORMATS)
def test_they_give_the_attitudes_of_the_whole(tmp_path, name):
    """In whatever order they are named."""
    FORMATS[name].write(tmp_path / name, samples())
    parts = parts_of(tmp_path, name)
    options = {"topic": FORMATS[name].topics[0]} if FORMATS[name].topics else {}
    with pytest.warns(quatprop.RemarkWarning, match="3 files are read as one log"):
        found = quatprop.propagate(parts, **options)
    whole = quatprop.propagate(tmp_path / name, **options)
    np.testing.assert_array_equal(found.t_ns, whole.t_ns)
    np.testing.assert_array_equal(found.wxyz, whole.wxyz)
    with pytest.warns(quatprop.RemarkWarning, match="3 files"):
        rates = quatprop.read_rates(tuple(parts), **options)
    assert rates == quatprop.read_rates(tmp_path / name, **options)


@pytest.fixture
def parts(tmp_path):
    """Return three files of a table."""
    return parts_of(tmp_path, "commas.csv")


def test_the_command_line_takes_them_and_records_each(tmp_path, parts):
    """With the SHA-256 of each; a gap between them is a gap."""
    out = tmp_path / "out.csv"
    done = run("propagate", *parts, "-o", out, "--report", tmp_path / "report.json", code=0)
    assert "warning: 3 files are read as one log, in the order of their times" in done.stderr
    told = json.loads((tmp_path / "report.json").read_text())
    assert [*told["files"]] == sorted(map(str, parts))
    assert told["source"]["path"] == " + ".join(map(str, parts))
    assert told["source"]["sha256"] is None
    assert "609.983 ms after" in run("propagate", parts[0], parts[2], "-o", out, code=0).stderr
    said = refused("propagate", parts[0], parts[2], "-o", out, "--on-gap", "error")
    assert "gap" in said


def test_what_one_of_them_lost_is_told_with_its_name(tmp_path):
    """The others are whole."""
    parts = parts_of(tmp_path, "none.bag")
    data = parts[1].read_bytes()
    parts[1].write_bytes(data[: len(data) * 2 // 3])
    done = run("propagate", *parts, "-o", tmp_path / "out.csv", "-t", "/imu", code=3)
    assert f"lost: {parts[1]}, " in done.stderr


def test_overlapping_files_are_merged(tmp_path):
    """By the times of their rows; samples that are in several files are read once."""
    write = FORMATS["commas.csv"].write
    write(tmp_path / "a.csv", samples(120))
    write(tmp_path / "b.csv", samples(SAMPLES - 120, 120)[:60])
    write(tmp_path / "c.csv", samples(40, 160))
    files = [tmp_path / f"{name}.csv" for name in "abc"]
    done = run("propagate", *files, "-o", tmp_path / "out.csv", code=0)
    assert "the files overlap: 20 samples in several of them are read once\n" in done.stderr
    assert "repeated" not in done.stderr
    found = quatprop.read_attitudes(tmp_path / "out.csv")
    assert found.t_ns.tolist() == samples().t_ns.tolist()


@pytest.mark.parametrize("name", ["commas.csv", "none.bag", "json.mcap", "plain.parquet"])
@pytest.mark.parametrize("packet", [1, 10])
def test_copies_of_a_recording_are_read_once(tmp_path, name, packet):
    """They were repeated timestamps, or with packets of samples no parts of one recording."""
    whole = samples()
    times = whole.t_ns[np.arange(SAMPLES) // packet * packet]
    files = []
    for number, part in enumerate((slice(None), slice(None), slice(50, 150))):
        files.append(tmp_path / f"{number}{name}")
        FORMATS[name].write(files[-1], quatprop.GyroSeries(times[part], whole.rate[part]))
    topic = {"topic": FORMATS[name].topics[0]} if FORMATS[name].topics else {}
    with pytest.warns(quatprop.RemarkWarning) as caught:
        found = quatprop.read_rates(files, **topic)
    assert "the files overlap: 300 samples in several" in str(caught[-1].message)
    np.testing.assert_array_equal(found.t_ns, times)
    np.testing.assert_array_equal(found.rate, quatprop.read_rates(files[0], **topic).rate)


def write_part(path, t_ns, rate):
    """Write a part of a recording; return its path."""
    rows = (",".join(map(repr, row)) for row in zip(t_ns.tolist(), *rate.T.tolist(), strict=True))
    path.write_text("t_ns,wx,wy,wz\n" + "\n".join(rows) + "\n")
    return path


STEP = 10_000_000


@settings(
    deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    lengths=st.tuples(st.integers(20, 400), st.integers(20, 400)),
    first=st.sampled_from([0, 1_700_000_000_000_000_000]),
    apart=st.integers(-9, 9),
    late=st.floats(0, 0.8),
)
def test_parts_whose_clocks_begin_anew_are_refused(tmp_path, lengths, first, apart, late):
    """They were interleaved sample by sample: 10 s became 5 s, and were 34 deg off."""
    times = [first + 10 * STEP + np.arange(length) * STEP for length in lengths]
    times[1] += int(late * min(lengths)) * STEP + apart * STEP // 10
    rates = [np.sin(k + np.arange(3 * lengths[k])).reshape(-1, 3) for k in range(2)]
    parts = [write_part(tmp_path / f"{k}.csv", times[k], rates[k]) for k in range(2)]
    for names in (parts, parts[::-1]):
        with pytest.raises(TimelineError, match="both have samples between"):
            quatprop.read_rates(names)
    with pytest.warns(quatprop.RemarkWarning, match="2 files are read one after another"):
        found = quatprop.read_rates(parts, in_sequence=True)
    np.testing.assert_array_equal(found.t_ns, times[0][0] + np.arange(sum(lengths)) * STEP)
    np.testing.assert_array_equal(found.rate, np.concatenate(rates))


@pytest.mark.parametrize("name", ["commas.csv", "none.bag", "json.mcap", "plain.parquet"])
def test_the_way_out_of_parts_whose_clocks_begin_anew(tmp_path, name):
    """The option that the refusal names gives the attitudes of the whole."""
    whole, files = samples(), []
    for number, (first, end) in enumerate(pairwise(CUTS)):
        part = samples(end - first, first)
        files.append(tmp_path / f"{number}{name}")
        t_ns = part.t_ns - part.t_ns[0] + whole.t_ns[0]
        FORMATS[name].write(files[-1], quatprop.GyroSeries(t_ns, part.rate))
    topic = ("-t", FORMATS[name].topics[0]) if FORMATS[name].topics else ()
    words = "propagate", *files, "-o", tmp_path / "out.csv", *topic
    assert refused(*words).endswith("name them in order, with --in-sequence")
    run(*words, "--in-sequence", code=0)
    found = quatprop.read_attitudes(tmp_path / "out.csv")
    expected = attitudes(whole.t_ns, whole.rate)
    assert found.t_ns[-1] - whole.t_ns[-1] == pytest.approx(0, abs=STEP)
    assert geodesic_angle(found.wxyz[-1], expected[-1]) < 0.01


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("lost", "apart"), [(0, 0), (3, 0), (60, 0), (0, 3_300_000), (3, 3_300_000), (0, 400_000_000)]
)
@pytest.mark.parametrize("suffix", ["bag", "mcap"])
def test_of_two_recorders_one_is_read(tmp_path, suffix, lost, apart):
    """They note the same messages at slightly different times, and lose others."""
    t_ns = 10**18 + np.arange(3000) * STEP
    rate = np.sin(np.arange(9000)).reshape(-1, 3)
    rng = np.random.default_rng(1)
    parts = []
    for late, name in enumerate("ab"):
        kept = np.sort(rng.permutation(3000)[lost:])
        recorded = t_ns[kept] + late * apart + rng.integers(0, STEP // 10, len(kept))
        messages = imu_messages(t_ns[kept], rate[kept], recorded=recorded)
        parts.append(write_messages(tmp_path / f"{name}.{suffix}", messages))
    words = "propagate", *parts, "-o", tmp_path / "o.csv"
    if lost < 60:
        said = run(*words, code=0).stderr
        assert f"{3000 - 2 * lost} samples in several of them are read once" in said
        at = np.arange(3000)
    else:
        said = refused(*words)
        assert "are in both, as if two recorders had written them; name one" in said
        run("propagate", parts[0], "-o", tmp_path / "o.csv", code=0)
        at = np.sort(np.random.default_rng(1).permutation(3000)[lost:])
    found = quatprop.read_attitudes(tmp_path / "o.csv")
    np.testing.assert_array_equal(found.t_ns, t_ns[at])
    assert geodesic_angle(found.wxyz[-1], attitudes(found.t_ns, rate[at])[-1]) < 1e-9


@settings(
    deadline=None, max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    cut=st.integers(20, 180), common=st.integers(0, 200), copied=st.booleans(), late=st.booleans()
)
def test_parts_of_a_split_recording_are_merged(tmp_path, cut, common, copied, late):
    """They overlap by copies of samples, or for a moment by samples out of order."""
    rate = np.random.default_rng(cut).normal(size=(400, 3))
    t_ns = np.arange(400) * STEP
    rows = np.arange(400)
    ours, theirs = rows[:cut], rows[cut:]
    if copied:
        ours = rows[: cut + common]
    elif late:
        # The last sample of one file is written into the next one, and the reverse.
        ours = np.append(rows[: cut - 1], cut)
        theirs = np.sort(np.append(rows[cut + 1 :], cut - 1))
    parts = [
        write_part(tmp_path / f"{name}.csv", t_ns[part], rate[part])
        for name, part in (("a", ours), ("b", theirs))
    ]
    with pytest.warns(quatprop.RemarkWarning) as caught:
        found = quatprop.read_rates(parts)
    assert "2 files are read as one log" in str(caught[0].message)
    assert len(caught) == 1 + (copied and common > 0)
    np.testing.assert_array_equal(found.t_ns, t_ns)
    np.testing.assert_array_equal(found.rate, rate)


def test_what_cannot_be_one_log_is_refused(tmp_path, parts):
    """In a sentence."""
    out = tmp_path / "out.csv"
    assert "a file is named twice" in refused("propagate", parts[0], parts[0], "-o", out)
    assert "not from stdin" in refused("propagate", parts[0], "-", "-o", out)
    FORMATS["none.bag"].write(tmp_path / "a.bag", samples(10))
    said = refused("propagate", tmp_path / "a.bag", parts[0], "-o", out)
    assert "several" in said


def numbered_part(path, order, first):
    """Write a table with columns in an order."""
    head = ",".join(f"gyro_{axis}_dps" for axis in order)
    lines = (f"{(first + k) / 100},1,2,3\n" for k in range(50))
    path.write_text(f"time_s,{head}\n{''.join(lines)}")
    return path


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
def test_columns_chosen_by_number_are_the_same_in_all_files(tmp_path):
    """The axes of the second file were read as others."""
    one, other, same = (
        numbered_part(tmp_path / f"{order}{first}.csv", order, first)
        for order, first in (("xyz", 0), ("zyx", 50), ("xyz", 50))
    )
    with pytest.raises(UsageError, match=r"zyx50.csv: rate_cols chooses 'gyro_z', 'gyro_y'.* but "):
        quatprop.read_rates([one, other], rate_cols=("1", "2", "3"))
    found = quatprop.read_rates([one, other])
    np.testing.assert_allclose(np.degrees(found.rate[[0, -1]]), [[1, 2, 3], [3, 2, 1]])
    by_name = quatprop.read_rates([one, other], rate_cols=[f"gyro_{x}_dps" for x in "xyz"])
    np.testing.assert_array_equal(by_name.rate, found.rate)
    assert len(quatprop.read_rates([one, same], rate_cols=("1", "2", "3")).t_ns) == 100


@pytest.mark.parametrize("count", [2, 3, 7])
@pytest.mark.parametrize("first", ["units", "no units"])
@pytest.mark.parametrize("options", [{}, {"rate_cols": ("1", "2", "3")}, {"time_col": "0"}])
@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
def test_parts_of_which_only_the_first_has_a_header_are_to_be_joined(
    tmp_path, count, first, options
):
    """As split(1) writes them; the error named columns that another error refused."""
    whole = numbered_part(tmp_path / "whole.csv", "xyz", 0)
    units = {}
    if first == "no units":
        whole.write_text(whole.read_text().replace("_dps", "").replace("_s,", ","))
        units = {"rate_unit": "deg/s", "time_unit": "s"}
    cuts = np.array_split(np.array(whole.read_text().splitlines(keepends=True), object), count)
    parts = [tmp_path / f"xa{'abcdefg'[k]}" for k in range(count)]
    for part, lines in zip(parts, cuts, strict=True):
        part.write_text("".join(lines))
    with pytest.raises(UsageError) as caught:
        quatprop.read_rates(parts, **options, **units)
    joined = f"cat {' '.join(map(str, parts))}"
    assert str(caught.value) == (
        f"{parts[1]}: it has no header, but {parts[0]} has one; join the parts first, as with "
        f"{joined}"
    )
    whole.write_bytes(subprocess.run(joined.split(), check=True, capture_output=True).stdout)
    assert len(quatprop.read_rates(whole, **options, **units).t_ns) == 50
    # In another order, the header is to be repeated.
    with pytest.raises(UsageError, match=f"; write that above the rows of {parts[1]}, too"):
        quatprop.read_rates(parts[1::-1], **options, **units)
    for part, lines in zip(parts[1:], cuts[1:], strict=True):
        part.write_text(cuts[0][0] + "".join(lines))
    read = quatprop.read_rates(parts[1::-1], **options, **units)
    assert len(read.t_ns) == len(cuts[0]) + len(cuts[1]) - 1


@pytest.mark.parametrize("numbers", [(1, 10, 2), (1, 2, 10), (8, 9, 10, 11), (2, 1)])
def test_files_in_another_order_than_their_numbers_are_said(tmp_path, numbers):
    """A shell lists log_10 before log_2."""
    files = [numbered_part(tmp_path / f"log_{number}.csv", "xyz", 0) for number in numbers]
    with pytest.warns(quatprop.RemarkWarning) as remarks:
        quatprop.read_rates(files, in_sequence=True)
    (said,) = [str(one.message) for one in remarks if "one after another" in str(one.message)]
    assert ("by the numbers in their names" in said) == ([*numbers] != sorted(numbers))
    if numbers == (1, 10, 2):
        assert "log_2.csv comes before " in said


@pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")
def test_dates_in_names_of_files_say_nothing_of_their_order(tmp_path):
    """The tenth of November was said to come after the first of December."""
    dates = ("10-11-2024", "01-12-2024")
    files = [numbered_part(tmp_path / f"rec_{date}.csv", "xyz", 0) for date in dates]
    with pytest.warns(quatprop.RemarkWarning) as remarks:
        quatprop.read_rates(files, in_sequence=True)
    assert not any("by the numbers in their names" in str(one.message) for one in remarks)


def test_files_of_two_sensors_and_clocks_of_other_names_are_refused(tmp_path):
    """Neither is in sequence, and tables have no time of recording to be chosen."""
    whole = samples()
    files = [tmp_path / "left.csv", tmp_path / "right.csv"]
    for number, path in enumerate(files):
        write_part(path, whole.t_ns + 3 * number, whole.rate * (number + 1))
    said = refused("propagate", *files, "-o", "-")
    assert "if they are of two sensors, name one; if they follow each other, and the clock" in said
    for path, time in zip(files, ("time_ns", "t (ns)"), strict=True):
        _, rows = path.read_text().split("\n", 1)
        path.write_text(f"{time},gx (rad/s),gy (rad/s),gz (rad/s)\n{rows}")
    said = refused("propagate", *files, "-o", "-")
    assert "with times in 't (ns)', 'time_ns'; rename the columns" in said


def test_files_at_other_sample_rates_may_follow_each_other(tmp_path):
    """Their rates were said to be names of columns."""
    files = [tmp_path / f"{rate}.h5" for rate in (100, 200)]
    for path in files:
        with h5py.File(path, "w") as file:
            file["gyr"] = samples().rate
            file["gyr"].attrs["unit"] = "rad/s"
            file.attrs["sampling_rate"] = int(path.stem)
    assert refused("propagate", *files, "-o", "-").endswith(
        "was recorded with 2 files, at sample rates of '100 Hz', '200 Hz'; name one file, or if "
        "they follow each other, name them in order, with --in-sequence"
    )
    with pytest.warns(quatprop.RemarkWarning, match="2 files are read one after another"):
        found = quatprop.read_rates(files, in_sequence=True)
    steps = np.diff(found.t_ns)
    np.testing.assert_array_equal(steps, np.repeat([STEP, STEP // 2], [SAMPLES, SAMPLES - 1]))
