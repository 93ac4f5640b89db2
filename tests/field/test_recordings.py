"""Real recordings through the command line, against an independent oracle.

``expected.json`` was computed with the libraries' own decoders and an 80-bit serial product.
"""

import json

import numpy as np
import pyarrow.csv
import pytest
from make.commands import run
from make.places import SHARED_LOGS

from quatprop import compare, propagate, read_rates
from quatprop.kinematics.quaternion import geodesic_angle

TOLERANCE_RAD = 1e-12

OPTIONS = {
    "two_imus/test1_2014_xsens.bag": {"topic": "/xsens/imu_data"},
}
"""Settings that a recording needs; all others are recognised as they are."""

EXPECTED = (
    json.loads((SHARED_LOGS / "expected.json").read_text())
    if (SHARED_LOGS / "expected.json").is_file()
    else {}
)
ARRIVED = {
    "irregular/tilt_laser.bag",  # up to 6 ms late in whole ms, and one sample 14 ms
    "two_imus/test1_2014_xsens.bag",  # within 0.02 ms of 100 Hz, but where it was held up
    "nested_imu/kiran_11sec_motion",  # its first sample, and others, were held up by up to 19 ms
}
"""Recordings with stamps of the time at which samples arrived, of a clock that is steady."""

AUK_FORMS = (
    "auk.bag", "auk_bz2.bag", "auk_lz4.bag", "auk_mcap_zstd", "auk_mcap_zstdfile",
    "auk_sqlite3", "auk_sqlite3_zstdmsg", "auk_sqlite3_zstdfile",
)  # fmt: skip


def propagated(tmp_path, *arguments):
    """Run `quatprop propagate` and return stamps and wxyz rows of its CSV."""
    out = tmp_path / "attitude.csv"
    run("propagate", *arguments, "-o", out, code=0)
    table = pyarrow.csv.read_csv(out)
    assert table.column_names == ["t_ns", "qw", "qx", "qy", "qz"]
    return table["t_ns"].to_numpy(), np.column_stack(table.columns[1:])


@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
@pytest.mark.filterwarnings("ignore::quatprop.DataLossWarning")
@pytest.mark.parametrize("name", EXPECTED or ["none"])
def test_attitudes_agree_with_the_oracle(shared_logs, tmp_path, name):
    """The stamps are the same, the attitudes midway and at the end within 1e-12 rad."""
    expected, options = EXPECTED[name], OPTIONS.get(name, {})
    words = [word for key, value in options.items() for word in (f"--{key}", value)]
    t_ns, mean = propagated(tmp_path, shared_logs / name, "--method", "mean", *words)
    rates = read_rates(shared_logs / name, **options)
    np.testing.assert_array_equal(rates.t_ns, t_ns)
    assert (len(t_ns), t_ns[0], t_ns[-1]) == (
        expected["samples"],
        expected["first_ns"],
        expected["last_ns"],
    )
    for method, oracle in expected["wxyz"].items():
        wxyz = mean if method == "mean" else propagate(rates, method=method).wxyz
        if "sensor_combined" in name and method == "coning":
            # Its samples are averages; the oracle takes them for rates, with the term of those.
            continue
        assert geodesic_angle(wxyz[len(wxyz) // 2], oracle["middle"]) < TOLERANCE_RAD
        assert geodesic_angle(wxyz[-1], oracle["final"]) < TOLERANCE_RAD


@pytest.mark.parametrize("name", EXPECTED or ["none"])
def test_info_agrees_with_the_oracle(shared_logs, name):
    """`info --json` has the samples, the stamps, the intervals and the largest rate."""
    expected = EXPECTED[name]
    (survey,) = json.loads(run("info", "--json", shared_logs / name, code=0).stdout)
    sources = survey["sources"]
    (source,) = [s for s in sources if s["source"] == expected.get("topic", s["source"])]
    assert source["samples"] == expected["samples"]
    assert (source["first_ns"], source["last_ns"]) == (expected["first_ns"], expected["last_ns"])
    assert source["min_dt_ns"] == expected["min_dt_ns"]
    assert source["median_dt_ns"] == pytest.approx(expected["median_dt_ns"], abs=1)
    assert source["max_dt_ns"] == expected["max_dt_ns"]
    assert source["max_rate_rad_s"] == pytest.approx(expected["max_rate_rad_s"], rel=1e-12)
    assert ("steady clock" in " ".join(source["remarks"])) == (name in ARRIVED)


@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
def test_times_of_arrival_become_those_of_the_sensor(shared_logs):
    """Log times that scatter by 1 ms follow header timestamps to 0.1 ms: 0.49 deg become 0.02."""
    log = shared_logs / "auk" / "auk.bag"
    stamped, arrived = read_rates(log), read_rates(log, clock="log")
    repaired = read_rates(log, clock="log", regular_time=True)
    assert np.std(arrived.t_ns - stamped.t_ns) > 990_000
    assert np.std(repaired.t_ns - stamped.t_ns) < 100_000
    report = propagate(arrived).report
    estimated = report.counts.steady_clock.error_rad
    truth = propagate(stamped)
    errors = {
        name: compare(propagate(rates), truth, align="first", time_offset="auto").error_rad.rms
        for name, rates in (("arrived", arrived), ("repaired", repaired))
    }
    assert errors["arrived"] == pytest.approx(estimated, rel=0.05)
    assert errors["repaired"] < errors["arrived"] / 20


def test_the_forms_of_one_recording_give_the_same_bytes(shared_logs, tmp_path):
    """Container and compression change nothing in the CSV, not one byte."""
    written = {}
    for form in AUK_FORMS:
        propagated(tmp_path, shared_logs / "auk" / form)
        written.setdefault((tmp_path / "attitude.csv").read_bytes(), []).append(form)
    assert list(written.values()) == [list(AUK_FORMS)]
