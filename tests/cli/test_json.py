"""The JSON of commands follows `quatprop/docs/schema.json`, with no other key."""

import json
from itertools import product

import pyarrow.parquet as pq
import pytest
from make.commands import run
from make.documents import GUIDES
from make.places import SAMPLE_LOGS
from make.schema import NAME, schema_text
from make.suites import TRUTH, pinned, stored, with_logs
from make.tables import write_attitudes, write_rates

import quatprop

jsonschema = pytest.importorskip("jsonschema")

SCHEMA = json.loads((GUIDES / NAME).read_text())


def closed(schema):
    """Return a schema without further keys than those that it names."""
    if isinstance(schema, list):
        return [closed(one) for one in schema]
    if not isinstance(schema, dict):
        return schema
    more = {"additionalProperties": False} if schema.get("required") else {}
    return {key: closed(one) for key, one in {**more, **schema}.items()}


CLOSED = closed(SCHEMA["$defs"])
OPEN = {**CLOSED, "convert": SCHEMA["$defs"]["convert"]}
"""A conversion keeps the metadata of its input."""


def refuse_nan(name):
    """No number of JSON is NaN or infinite."""
    raise AssertionError(name)


def valid(name, text):
    """Return what a command has printed, which its schema describes."""
    content = json.loads(text, parse_constant=refuse_nan)
    validator = jsonschema.Draft202012Validator({"$ref": f"#/$defs/{name}", "$defs": OPEN})
    assert [f"{error.json_path}: {error.message}" for error in validator.iter_errors(content)] == []
    return content


def test_the_schema_is_as_the_classes_are():
    """`make documents` writes it."""
    assert (GUIDES / NAME).read_text() == schema_text()
    jsonschema.Draft202012Validator.check_schema(SCHEMA)


def test_the_whole_schema_takes_what_some_command_prints():
    """And nothing else."""
    validator = jsonschema.Draft202012Validator(SCHEMA)
    log = SAMPLE_LOGS / "spin.csv"
    assert validator.is_valid(json.loads(run("info", log, "--json", code=0).stdout))
    assert not validator.is_valid({"rubbish": 1})
    assert not validator.is_valid([{"rubbish": 1}])


PROPAGATED = {
    "as it is": [],
    "errors": ["--noise-density", "0.2deg/sqrt(h)", "--bias-sigma", "20deg/h", "--sigma"],
    "corrected": ["--mount", "x,-y,-z", "--bias", "0.1,0,0", "--start", "+1s", "--end", "-1s"],
    "regular": ["--regular-time", "--rate", "30"],
    "in space": ["--rates", "inertial", "--method", "quintic", "--layout", "xyzw"],
    "on Earth": ["--earth-rate", "48,90"],
}
AT_REST = {"rest": ["--bias", "static"], "rests": ["--bias", "static:nearest"]}
LOGS = ("spin.csv", "coning.mcap", "rest.parquet", "tumbling.bag", "tumbling_ros2")


@pytest.mark.parametrize(
    ("log", "how"),
    [
        *product(LOGS, ["as it is"]),
        *product(["tumbling.bag"], PROPAGATED),
        *product(["rest.parquet"], AT_REST),
    ],
)
def test_reports_of_propagate(tmp_path, log, how):
    """Also those in the output."""
    report, out = tmp_path / "report.json", tmp_path / "out.parquet"
    words = ["propagate", SAMPLE_LOGS / log, *(PROPAGATED | AT_REST)[how], "-q"]
    run(*words, "-o", out, "--report", report)
    found = valid("propagate", report.read_text())
    assert "timings" in found
    stored = valid("propagate", pq.read_metadata(out).metadata[b"quatprop"])
    assert stored["result"] == found["result"]


def test_reports_of_a_damaged_log(tmp_path):
    """With losses, gaps and remarks."""
    log = tmp_path / "log.csv"
    rows = [f"{k * 10_000_000 * (1 + k // 50)},0.1,0.2,{k}" for k in range(100)]
    log.write_text("\n".join(["t_ns,wx,wy,wz", *rows[:70], "oops,1,2", *rows[70:]]) + "\n")
    report = tmp_path / "report.json"
    run("propagate", log, "-o", tmp_path / "a.csv", "--report", report, "-q", code=3)
    found = valid("propagate", report.read_text())
    assert found["losses"]
    assert valid("info", run("info", "--json", log).stdout)[0]["losses"]


def test_surveys(tmp_path):
    """Of logs of rates, of attitudes, and of outputs."""
    out = tmp_path / "out.parquet"
    run("propagate", SAMPLE_LOGS / "spin.csv", "-o", out, "-q", code=0)
    names = (*LOGS, "coning.truth.csv", "rest.truth.parquet")
    found = valid(
        "info", run("info", "--json", *(SAMPLE_LOGS / name for name in names), out).stdout
    )
    assert len(found) == len(names) + 1


COMPARED = (
    [],
    ["--tol", "0.1deg", "--min-coverage", "99"],
    ["--align", "mean", "--time-offset", "10ms", "--window", "1s", "--window-rms-tol", "9deg"],
    ["--align", "mount", "--max-dt", "1ms"],
    ["--align", "yaw", "--tol-heading", "1deg", "--tol-inclination", "1e-9deg"],
    ["--judge", "+1s..-1s", "--rms-tol", "1e-9deg", "--align", "first"],
)


@pytest.mark.parametrize("options", COMPARED, ids=" ".join)
def test_comparisons(tmp_path, options):
    """With every kind of alignment and of limit."""
    out = tmp_path / "out.parquet"
    errors = ["--noise-density", "0.2deg/sqrt(h)", "--sigma"]
    run("propagate", SAMPLE_LOGS / "tumbling.bag", "-o", out, *errors, "-q", code=0)
    shown = run("compare", out, SAMPLE_LOGS / "tumbling.truth.csv", "--json", *options)
    assert shown.exit_code in {0, 1}, shown.stderr
    valid("compare", shown.stdout)


def test_noise_and_calibrations(tmp_path):
    """Of a sensor at rest, and of one that turns."""
    rest, log = tmp_path / "rest.mcap", tmp_path / "log.mcap"
    run("simulate", rest, "--motion", "rest", "--duration", "5m", "--noise", "1e-4", code=0)
    valid("noise", run("noise", rest, "--json").stdout)
    run("simulate", log, "--motion", "tumbling", "--duration", "30s", code=0)
    truth = next(tmp_path.glob("log.truth*"))
    valid("calibrate", run("calibrate", log, truth, "--time-offset", "0", "--json").stdout)


def test_batches(tmp_path):
    """One log cannot be read."""
    (tmp_path / "bad.mcap").write_bytes(b"no log")
    logs = [tmp_path / "bad.mcap", *(SAMPLE_LOGS / name for name in LOGS[1:])]
    shown = run("batch", *logs, "-o", tmp_path / "out", "--json", "-q", code=2)
    assert len(valid("batch", shown.stdout)) == len(LOGS)
    assert any(one["error"] for one in json.loads(shown.stdout))


def test_suites(tmp_path):
    """Cases that pass, fail and end with an error."""
    suite = pinned(with_logs(tmp_path), TRUTH + stored())
    found = valid("check", run("check", suite, "--json", code=0).stdout)
    assert found["counts"]["pass"] == 2
    suite.write_text(suite.read_text().replace('tol = "0.1deg"', 'tol = "1e-9deg"') + stored("new"))
    valid("check", run("check", suite, "--json", code=2).stdout)


@pytest.mark.parametrize("options", [["--convention", "jpl"], ["--as", "rotvec", "--start", "+1s"]])
def test_conversions(tmp_path, options):
    """Of attitudes with and without a history."""
    report, out = tmp_path / "report.json", tmp_path / "out.parquet"
    run("propagate", SAMPLE_LOGS / "spin.csv", "-o", out, "-q", code=0)
    for log in (out, SAMPLE_LOGS / "tumbling.truth.csv"):
        words = ["convert", log, tmp_path / "b.csv", "--report", report, "-q"]
        run(*words, *options, code=0)
        valid("convert", report.read_text())


@pytest.mark.parametrize("name", ["healthy", "short", "late"])
def test_crosscheck(name, tmp_path):
    """Sources that agree, that differ, and that are too short to be compared."""
    rates, truth = quatprop.simulate(motion="tumbling", duration="1s" if name == "short" else "20s")
    log = write_rates(
        tmp_path / "rates.csv",
        [(t, *w) for t, w in zip(rates.t_ns.tolist(), rates.rate.tolist(), strict=True)],
        "t_ns,wx_rad_s,wy_rad_s,wz_rad_s",
    )
    late = 300_000_000 if name == "late" else 0
    reference = write_attitudes(tmp_path / "truth.csv", truth.t_ns + late, truth.wxyz)
    code = {"healthy": 0, "short": 2, "late": 1}[name]
    said = valid("crosscheck", run("crosscheck", log, reference, "--json", code=code).stdout)
    assert said["exit"] == code
