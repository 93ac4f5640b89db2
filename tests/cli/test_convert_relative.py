"""``convert --relative-to``: attitudes of a body in the axes of another, against SciPy."""

import json
import re

import numpy as np
import pytest
from make.commands import refused, run
from make.ros import imu_messages, write_messages
from make.tables import write_rates
from scipy.spatial.transform import Rotation

import quatprop
from quatprop import AttitudeSeries

T_NS = np.arange(101) * 10_000_000


def written(path, t_ns, turns):
    """Write attitudes and return where."""
    quatprop.write(AttitudeSeries(t_ns, turns.as_quat(scalar_first=True)), path)
    return path


@pytest.fixture
def bodies(tmp_path):
    """Return files of a thigh and a shank of a knee that bends by a degree a sample."""
    thigh = Rotation.from_euler("ZYX", [(k / 9, -k / 7, k / 5) for k in range(101)], degrees=True)
    knee = Rotation.from_euler("y", np.arange(101)[:, None], degrees=True)
    return (
        written(tmp_path / "thigh.csv", T_NS, thigh),
        written(tmp_path / "shank.csv", T_NS, thigh * knee),
    )


def test_the_angle_of_a_joint(bodies, tmp_path):
    """As Euler angles, in a file of which a picture is drawn; there was Python alone."""
    thigh, shank = bodies
    out, report = tmp_path / "knee.csv", tmp_path / "report.json"
    angles = "--as", "euler-zyx", "--euler-unit", "deg", "--report", report
    done = run("convert", shank, out, "--relative-to", thigh, *angles, code=0)
    assert f"relative to {thigh}" in done.stderr
    expected = np.column_stack([np.zeros(101), np.arange(101), np.zeros(101)])
    found = np.loadtxt(out, delimiter=",", skiprows=1)[:, 1:]
    near = slice(0, 85)  # in gimbal lock, the two others are of no meaning
    np.testing.assert_allclose(found[near], expected[near], atol=1e-9)
    step = json.loads(report.read_text())["conversions"][0]
    assert step["to"]["relative_to"] == str(thigh)
    run("plot", out, "-o", tmp_path / "knee.svg", code=0)


@pytest.mark.parametrize(
    ("rows", "kept"),
    [
        (np.r_[10:40:2, 62:91:2], [*range(10, 39), *range(62, 91)]),
        (np.r_[99:100], [99]),
    ],
)
def test_times_that_the_other_body_does_not_cover_are_omitted(bodies, tmp_path, rows, kept):
    """Before, after and in a gap of it; between its samples it is interpolated."""
    thigh, shank = bodies
    other = quatprop.read_attitudes(thigh)
    part, out = tmp_path / "part.csv", tmp_path / "knee.csv"
    quatprop.write(other[rows], part)
    done = run("convert", shank, out, "--relative-to", part, code=0)
    assert f"omitted {101 - len(kept)} rows before, after or in a gap" in done.stderr
    found = quatprop.read_attitudes(out)
    assert found.t_ns.tolist() == T_NS[kept].tolist()
    bent = Rotation.from_quat(found.wxyz, scalar_first=True).magnitude()
    np.testing.assert_allclose(np.degrees(bent), kept, atol=0.01)


def test_parts_of_a_log_that_the_other_body_does_not_cover_give_no_rows(tmp_path):
    """Neither rates, the last of which is repeated, nor messages."""
    t_ns, log, other = np.arange(200) * 10_000_000, tmp_path / "log.mcap", tmp_path / "other.csv"
    turns = Rotation.from_rotvec(np.outer(t_ns * 1e-9, [0, 1, 0]))
    write_messages(log, imu_messages(t_ns, (), turns.as_quat(scalar_first=True)))
    written(other, t_ns[80:120], Rotation.identity(40))
    relative = "--relative-to", other, "-q"
    run("convert", log, tmp_path / "rates.csv", "--as", "body-rates", *relative, code=0)
    found = np.loadtxt(tmp_path / "rates.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(found, [[t, 0, 1, 0] for t in t_ns[80:120]], atol=1e-9)
    run("convert", log, tmp_path / "out.mcap", *relative, code=0)
    assert quatprop.read_attitudes(tmp_path / "out.mcap").t_ns.tolist() == t_ns[80:120].tolist()


def test_series_without_a_common_clock_are_refused(bodies, tmp_path):
    """Times of another clock, and times that do not increase, with the file that has them."""
    thigh, shank = bodies
    other = quatprop.read_attitudes(thigh)
    later, back, twice, out = (
        tmp_path / f"{name}.csv" for name in ("later", "back", "twice", "out")
    )
    quatprop.write(AttitudeSeries(other.t_ns + 10**12, other.wxyz), later)
    quatprop.write(AttitudeSeries(other.t_ns[::-1], other.wxyz), back)
    quatprop.write(AttitudeSeries(other.t_ns // 20_000_000, other.wxyz), twice)
    for other_body, sentence in (
        (later, f"{later}: it has no attitudes at these times; are both"),
        (back, f"{back}: its timestamps do not increase"),
        (twice, f"{twice}: its timestamps do not increase"),
        (tmp_path / "no.csv", f"{tmp_path / 'no.csv'}: no such file"),
    ):
        assert sentence in refused("convert", shank, out, "--relative-to", other_body)
    assert str(thigh) in refused("convert", shank, thigh, "--relative-to", thigh)
    assert not out.exists()


TIMES = [*range(0, 10**9, 10**7)]
UNREADABLE = {
    "zero": ("t_ns,qw,qx,qy,qz", [(t, int(t != 5 * 10**8), 0, 0, 0) for t in TIMES]),
    "long": ("t_ns,qw,qx,qy,qz", [(t, 1.1, 0, 0, 0) for t in TIMES]),
    "unit": ("time,qw,qx,qy,qz", [(t // 1000, 1, 0, 0, 0) for t in TIMES]),
    "angles": ("t_ns,yaw,pitch,roll", [(t, 0.1, 0.2, 0.3) for t in TIMES]),
    "order": ("t_ns,q1,q2,q3,q4", [(t, 1, 0, 0, 0) for t in TIMES]),
    "names": ("t_ns,a,b,c,d", [(t, 1, 0, 0, 0) for t in TIMES]),
}
"""Series that need a setting, by what is odd of them: columns and rows."""


@pytest.mark.parametrize("what", UNREADABLE)
def test_settings_that_a_refusal_names_are_accepted(bodies, tmp_path, what):
    """Some were accepted, and had no effect on the other body; others were of no command."""
    thigh, shank = bodies
    header, rows = UNREADABLE[what]
    other, out = tmp_path / f"{what}.csv", tmp_path / "out.csv"
    write_rates(other, rows, header)
    said = refused("convert", thigh, out, "--relative-to", other)
    settings = re.findall(r"--[a-z-]+", said)
    given = {"--on-invalid": "drop", "--time-unit": "us", "--from-angle-unit": "rad",
             "--quat-cols": ",".join(header.split(",")[1:]), "--from-layout": "wxyz",
             "--time-col": "t_ns"}  # fmt: skip
    options = [word for name in settings for word in (name, given.get(name)) if word]
    if "of quatprop convert" in said:
        run("convert", other, tmp_path / "read.csv", *options, code=0)
        run("convert", shank, out, "--relative-to", tmp_path / "read.csv", code=0)
    else:
        code = 3 if what == "zero" else 0
        done = run("convert", shank, out, "--relative-to", other, *options, code=code)
        assert ("lost" in done.stderr) == (what == "zero")
    assert len(quatprop.read_attitudes(out)) == 100


def test_the_function_with_the_settings_is_named_in_python(bodies, tmp_path):
    """As above, for functions that take a second file."""
    _, shank = bodies
    for what, (header, rows) in UNREADABLE.items():
        write_rates(tmp_path / f"{what}.csv", rows, header)
    rates = tmp_path / "rates.csv"
    write_rates(rates, [(t, t * 1e-9, 0.1, 0) for t in TIMES])
    for what, of in (("zero", ""), ("unit", " of convert")):
        with pytest.raises(quatprop.QuatpropError, match=rf"'(drop'{of} omits them|ns'{of})$"):
            quatprop.convert(shank, tmp_path / "o.csv", relative_to=tmp_path / f"{what}.csv")
        with pytest.raises(quatprop.QuatpropError, match=r"'(drop|ns)' of read_attitudes"):
            quatprop.calibrate(rates, tmp_path / f"{what}.csv")
