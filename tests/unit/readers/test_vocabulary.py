"""Column names to time, rates and units: known conventions, clear names, options."""

import io
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from make.table_rates import refusal, table_rates

from quatprop import GyroSeries, RemarkWarning, propagate
from quatprop.base.errors import NoRatesError, UndeclaredError, UnsupportedLogError, UsageError
from quatprop.readers.rate_signals import choose_rates
from quatprop.readers.tables.csv import CsvLog
from quatprop.readers.tables.table_log import parse_name
from quatprop.settings.quantities import RATES
from quatprop.settings.reading import RateSelection

NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}

KNOWN = """
1 2 3 rad/s | 0 ns | quatprop | t_ns,w{xyz}
1 2 3 rad/s | 0 ns | EuRoC | #timestamp [ns],w_RS_S_{xyz} [rad s^-1]
1 2 3 rad/s | 0 us | PX4 ulog2csv | timestamp,gyro_rad[{012}],gyro_integral_dt
2 3 4 rad/s | 1 us | PX4 ulog2csv | timestamp,timestamp_sample,xyz[{012}],xyz_derivative[0]
3 4 5 rad/s | 1 us | PX4 ulog2csv | timestamp,timestamp_sample,device_id,{xyz},error_count,samples
1 2 3 rad/s | 0 us | PX4 ulog2csv | timestamp,rollspeed,pitchspeed,yawspeed,q[{012}],q[3]
3 4 5 rad/s | 2 ns | rostopic echo -p | %time,field.header.seq,field.header.stamp,\
field.angular_velocity.{xyz},field.angular_velocity_covariance0
2 3 4 rad/s | 0 1 s | ROS messages as columns | header.stamp.sec,header.stamp.nanosec,\
angular_velocity.{xyz}
4 5 6 rad/s | 2 3 s | ROS messages as columns | Time,header.seq,header.stamp.secs,\
header.stamp.nsecs,angular_velocity.{xyz}
1 2 3 deg/s | 0 s | x-io | Time (s),Gyroscope {XYZ} (deg/s),Accelerometer X (g)
1 2 3 deg/s | 0 us | x-io | Timestamp (us),Gyroscope {XYZ} (deg/s)
1 2 3 rad/s | 0 s | phyphox | Time (s),Gyroscope {xyz} (rad/s),Absolute (rad/s)
1 2 3 deg/s | 0 s | | t_s,g{xyz}_dps
1 2 3 rad/s | 0 s | | t_s,imu_g{xyz}_rad_s
1 2 3 mdeg/s | 0 ms | | t_ms,w{xyz}_mdeg_s
1 2 3 deg/s | 0 ms | | time_ms,gyro_{xyz}_dps
2 3 4 deg/s | 1 ms | | T [\u00b0C],timestamp_ms,g{xyz}_dps
3 2 1 rad/s | 0 s | | t [s];omega_{zyx} [rad/s]
3 4 5 rad/s | 1 us | ArduPilot | timestamp,TimeUS,I,Gyr{XYZ},AccX,T
5 6 7 deg/s | 1 us | Movella DOT | PacketCounter,SampleTimeFine,Euler_{XYZ},Gyr_{XYZ}
3 4 5 deg/s | 1 us | Betaflight | loopIteration,time (us),axisP[0],gyroADC[{012}]
3 4 5 rad/s | 2 ns | Android GnssLogger | # UncalGyro,utcTimeMillis,elapsedRealtimeNanos,\
UncalGyro{XYZ}RadPerSec,Drift{XYZ}RadPerSec
2 3 4 rad/s | 0 ns | Sensor Logger | time,seconds_elapsed,rotationRate{XYZ},gravityX
4 3 2 rad/s | 0 ns | Sensor Logger | time,seconds_elapsed,{zyx}
1 2 3 rad/s | 0 s | | Zeit (s);Gyroskop {xyz} (rad/s)
2 3 4 deg/s | 0 s | | UTC time (s),time ITOW,{xyz}Rate (deg/s)
1 2 3 rad/s | 0 ns | | timestampNs,userRotationRate{XYZ}(rad/s)
1 2 3 deg/s | 0 ms | | time_boot_ms,{XYZ}_GYRO_OUT [deg/s],exposure (us)
1 2 3 deg/s | 0 s | | __time (s),{pqr} (deg/s)
1 2 3 rad/s | 0 s | | time_s,{pqr}_rad_s
1 2 3 rad/s | 0 s | | t [s],\u03c9{xyz} [rad\u00b7s\u207b\u00b9]
1 2 3 rad/s | 0 ns | TUM-VI | timestamp[ns],w.{xyz},a.{xyz}
7 8 9 rad/s | 1 us | Project Aria | graph_uid,tracking_timestamp_us,utc_timestamp_ns,\
q{xyz}_world_device,qw_world_device,angular_velocity_{xyz}_device
4 5 6 deg/s | 0 ms | | t_ms,a{XYZ},g{XYZ}_dps
1 2 3 deg/s | 0 s | | t (s),g{xyz} (degrees per second)
"""
"""The columns of rates and their unit, those of time and theirs, the convention, the header."""


def header_of(short):
    """Return a header: three letters in braces are three columns."""
    mark = ";" if ";" in short else ","
    parts = (re.split(r"\{(...)\}", name) for name in short.split(mark))
    names = ([a[0]] if len(a) == 1 else [a[0] + letter + a[2] for letter in a[1]] for a in parts)
    return mark.join(name for three in names for name in three)


FILES = {
    "xyz[0]": "a_vehicle_angular_velocity_0.csv",
    ",device_id,": "a_sensor_gyro_0.csv",
    ",z,y,x": "Gyroscope.csv",
}
"""Names of files that a convention goes by, and a part of the header of each."""


def row(header):
    """Return a row of a table with a header: each cell tells its column, from 1."""
    delimiter = ";" if ";" in header else ","
    return delimiter.join(str(k + 1) for k in range(header.count(delimiter) + 1))


def chosen(header, name="log.csv", **options):
    """Return the rates of a table of one row, and the columns that time and rates are from."""
    with CsvLog(io.BytesIO(f"{header}\n{row(header)}\n".encode())) as log:
        log.path = Path(name)
        source = choose_rates(log, RateSelection(**options))
        (batch,) = source.batches()
    return source, batch.t_ns.tolist(), batch.rate[0]


@pytest.mark.parametrize("known", KNOWN.strip().splitlines())
def test_a_header_that_names_columns_and_units_needs_no_options(known):
    """Every convention is recognised with its columns, its units and its name."""
    columns, times, dialect, header = (part.strip() for part in known.split("|"))
    *columns, unit = columns.split()
    *times, time_unit = times.split()
    header = header_of(header)
    name = next((name for sign, name in FILES.items() if sign in header), "log.csv")
    source, t_ns, rate = chosen(header, name)
    assert source.type_name == dialect
    time, *rest = (int(k) + 1 for k in times)
    assert t_ns == [time * NS[time_unit] + sum(rest)]
    factor = RATES[unit.removeprefix("m")] * (1e-3 if unit[0] == "m" else 1)
    np.testing.assert_allclose(rate, [(int(k) + 1) * factor for k in columns], rtol=1e-15)
    # Averages over the interval before each stamp.
    assert source.method == ("end" if "gyro_rad" in header else None)


@pytest.mark.parametrize(
    ("header", "options", "numbers"),
    [
        ("t_s,gx,gy,gz", {}, (1, 2, 3)),
        # Next to an accelerometer or a magnetometer they cannot be meant otherwise.
        ("t_s,aX,aY,aZ,gX,gY,gZ", {}, (4, 5, 6)),
        ("t_s,AX,AY,AZ,GX,GY,GZ", {}, (4, 5, 6)),
        ("t_s,ax,ay,az,gx,gy,gz,mag_x,mag_y,mag_z,temp", {}, (4, 5, 6)),
        ("t_s,p,q,r", {}, (1, 2, 3)),
        ("t,frame_id,gyro_x,gyro_y,gyro_z", {"time_unit": "s"}, (2, 3, 4)),
        # As spelled, by the bare name, or by number.
        ("t_s,x,y,z", {"rate_cols": ("x", "y", "z")}, (1, 2, 3)),
        ("t_s,x,y,z", {"rate_cols": ("1", "2", "3")}, (1, 2, 3)),
        ("t_s,x,y,z", {"rate_cols": ("X", "#y", "z [rad/s]")}, (1, 2, 3)),
        # The second of two gyroscopes.
        (
            "t_s,wx (rad/s),wy (rad/s),wz (rad/s),gx,gy,gz",
            {"rate_cols": ("4", "5", "6")},
            (4, 5, 6),
        ),
        ("t_s,wx,wy,wz,x_gyro,y_gyro,z_gyro", {"rate_cols": ("4", "5", "6")}, (4, 5, 6)),
        ("t_s,wx,wy,wz,wx,wy,wz", {"rate_cols": ("1", "2", "3")}, (1, 2, 3)),
    ],
)
def test_options_declare_what_the_header_does_not(header, options, numbers):
    """Where the user says the unit of rates, gx and p are rates, and any column may be named."""
    _, t_ns, rate = chosen(header, rate_unit="deg/s", **options)
    assert t_ns == [10**9]
    assert rate.tolist() == [(k + 1) * RATES["deg/s"] for k in numbers]


def test_a_name_wins_over_a_number(tmp_path):
    """A column called "1" is found by its name, not as the second column."""
    path = tmp_path / "log.parquet"
    pd.DataFrame({"t_s": [1], "2": [1.0], "1": [2.0], "3": [3.0]}).to_parquet(path)
    found = table_rates(path, rate_cols=("1", "2", "3"), rate_unit="rad/s")
    assert found.rate.tolist() == [[2, 1, 3]]


@pytest.mark.parametrize(
    "header",
    [
        "t_s,gx,gy,gz,turn_x,turn_y,turn_z",
        "t_s,qw,qx,qy,qz,gx,gy,gz",
        "t_s,gx,gy,gz,p,q,r",
        "time,seconds_elapsed,z,y,x",
        *("t,b_w_RS_S_{xyz}", "t,b_w_RS_S_{xyz} [rad s^-1]", "t,bias_gyro_{xyz}"),
        *(f"t_ns,{what}_{{xyz}} [rad/s]" for what in ("drift", "bias", "cov", "error")),
    ],
)
def test_axes_that_may_be_no_rates_are_not_taken_for_them(header):
    """A bias or noise is none, whatever its unit; gx next to other axes may be gravity."""
    with pytest.raises(NoRatesError, match="name the columns with rate_cols and time_col"):
        chosen(header_of(header), "Accelerometer.csv", rate_unit="deg/s")


@pytest.mark.parametrize(
    ("text", "key", "unit"),
    [
        ("\ufeff#timestamp [ns]", "timestamp", "ns"),
        ("gyro_rad[0]", "gyro_rad[0]", ""),
        ("Gyr X (\u00b0/s)", "gyr_x", "deg/s"),
        ("time (\u00b5s)", "time", "us"),
        ("/imu/angular_velocity/x", "imu.angular_velocity.x", ""),
        ("header.stamp.sec", "header.stamp.sec", ""),
        ("q_RS_w []", "q_rs_w", ""),
        ("gyro_x_rad_s", "gyro_x", "rad/s"),
        ("timestamp_us", "timestamp", "us"),
        ("Gyr_X [mdps]", "gyr_x", "mdps"),
        ("Gyro-X (d/s)", "gyro_x", "deg/s"),
        ("Gyro X in radians/s", "gyro_x", "rad/s"),
        ("Gyro X in deg/s", "gyro_x", "deg/s"),
        ("gyro_x, degrees per second", "gyro_x", "deg/s"),
        ("gyro_x \u00b0/s", "gyro_x", "deg/s"),
        ("wx (degs/sec)", "wx", "deg/s"),
        ("acc x in m/s", "acc_x_in_m.s", ""),
        ("time in s", "time_in_s", ""),
        ("wx (degree/sec)", "wx", "deg/s"),
        ("wx [\u00b0 / seconds]", "wx", "deg/s"),
        ("wx (Rads/s)", "wx", "rad/s"),
        ("wx (rad\u00b7s\u22121)", "wx", "rad/s"),
        ("wx (degree s-1)", "wx", "deg/s"),
        ("wx (degrees s^-1)", "wx", "deg/s"),
        ("wx (\u00b0 s\u207b\u00b9)", "wx", "deg/s"),
        ("wx (radian s-1)", "wx", "rad/s"),
        ("wx (radians\u00b7sec-1)", "wx", "rad/s"),
        ("wx (m\u00b0/s)", "wx", "mdeg/s"),
        ("wx (mdeg s-1)", "wx", "mdeg/s"),
        ("wx (milliradians per second)", "wx", "mrad/s"),
        ("wx (rad/s^2)", "wx", "rad/s^2"),
        ("wx (rad s-2)", "wx", "rads-2"),
        ("q (degrees)", "q", "deg"),
    ],
)
def test_a_name_is_taken_apart(text, key, unit):
    """Marks, case, brackets and unit suffixes are separated from the name proper."""
    found = parse_name(text)
    assert (found.text, found.key, found.unit) == (text, key, unit)


ASKED = (
    "log.csv: the unit of the rates '{0}x', '{0}y', '{0}z' and the unit of the time 't' are not "
    "declared; specify them with rate_unit='rad/s' or 'deg/s' and time_unit='s' or 'ms' or "
    "'us' or 'ns'"
)
TWO = (
    "which set of rates to use (their x columns are '{}', '{}') is not declared; specify it "
    "with rate"
)
OF_SERIES = (
    "which set of rates to use (their x columns are '{0}_x', '{1}_x') and the unit of the rates "
    "'{0}_x', '{0}_y', '{0}_z' and the unit of the time 't' are not declared; specify them with "
    "series='a' or 'b' and rate_unit='rad/s' or 'deg/s' and time_unit='s' or 'ms' or 'us' or 'ns'"
)
MIXED = (
    "by header or convention 'wx_rad_s', 'wy_rad_s' are in rad/s and 'wz_deg_s' is in deg/s; "
    "convert them to one unit"
)
MIXED_UNKNOWN = (
    "by header or convention 'gx (deg/s)', 'gz (deg/s)' are in deg/s and 'gy (grad/s)' is in "
    "'grad/s'; convert them to one unit"
)
PARTLY = (
    "the unit of the rates 'gy', while 'gx (dps)', 'gz (dps)' are in deg/s, is not declared; "
    "specify it with rate_unit='deg/s'"
)
ANGLES = "Time (s),Roll rate (\u00b0/s),Pitch rate (\u00b0/s),Yaw rate (\u00b0/s)"
ABOUT = (
    "log.csv: about which axes 'Roll rate (\u00b0/s)', 'Pitch rate (\u00b0/s)', "
    "'Yaw rate (\u00b0/s)' turn (those of the body, or others, as in OpenRocket) is not "
    "declared; specify it with rate_cols='1,2,3' if they are those of the body"
)
QUATPROP = "t_ns,wx,wy,wz"
XYZ = {"rate_cols": ("x", "y", "z"), "time_col": "t", "rate_unit": "rad/s", "time_unit": "us"}


REFUSED = {
    UndeclaredError: [
        # Without the title of a gcsv, gx may be gravity.
        ("t,g{xyz}", {}, ASKED.format("g")),
        ("t,frame_id,gyro_{xyz}", {}, ASKED.format("gyro_")),
        ("t_ns,w{xyz},g{xyz}_dps", {}, TWO.format("wx", "gx_dps") + "_cols='X,Y,Z'"),
        ("t,a.gyro_{xyz},b.gyro_{xyz}", {}, OF_SERIES.format("a.gyro", "b.gyro")),
        ("t,a.gyro_{xyz},b.gyro_{xyz}", {"series": "c"}, "specify it with series='a' or 'b'"),
        # Rates known by name are not preferred to those known by unit.
        ("t_ns,w{xyz} (rad/s),g{xyz} (deg/s)", {}, TWO.format("wx (rad/s)", "gx (deg/s)")),
        ("t_ns,w{xyz},{xyz}_gyro", {}, TWO.format("wx", "x_gyro")),
        # Nothing but their numbers tells which of the same names is meant.
        ("t_ns,w{xyz},w{xyz}", {}, "1-2-3, 4-5-6"),
        ("t_ns,w{xyz},wz", {}, "1-2-3, 1-2-4"),
        ("t_ns,gyro_{xyz}_dps,gyro_{xyz}_rad_s", {}, "which set of rates to use"),
        ("t_s,gx (dps),gy,gz (dps)", {}, PARTLY),
        # OpenRocket's pitch and yaw are about axes that follow the airflow.
        (ANGLES, {}, ABOUT),
    ],
    UsageError: [
        (
            QUATPROP,
            {"rate_cols": ("0", "2", "1")},
            (
                "log.csv: 't_ns' cannot be both the time and one of rate_cols; name other columns, "
                "or the time with time_col"
            ),
        ),
        (QUATPROP, {"rate_cols": ("wx", "1", "wz")}, "rate_cols names a column twice"),
        ("t,a,y,z", XYZ, "rate_cols asks for column 'x'; the columns are 't', 'a'"),
        ("t,x,{xyz}", XYZ, "2 columns are called 'x'; choose one by its number"),
        ("t_s,wx_rad_s,wy_rad_s,wz_deg_s", {}, MIXED),
        ("t_s,gx (deg/s),gy (grad/s),gz (deg/s)", {}, MIXED_UNKNOWN),
        (
            QUATPROP,
            {"sample_rate": 200.0, "time_col": "t_ns"},
            "time_col and sample_rate contradict",
        ),
        (QUATPROP, {"clock": "publish"}, "this table has no publish time"),
        (QUATPROP, {"topic": "/imu"}, "topic is for logs of messages and this is a table"),
        *(
            (QUATPROP, {"sample_rate": rate}, "is not a rate above 0 Hz")
            for rate in (0.0, -1.0, float("nan"), float("inf"))
        ),
    ],
    UnsupportedLogError: [
        (
            "t_ns,Gyr_{XYZ} [counts]",
            {},
            "rad/s or deg/s, or if they are, name that with rate_unit='rad/s' or 'deg/s'",
        )
    ],
}


@pytest.mark.parametrize(
    ("error", "header", "options", "sentence"),
    [(error, *case) for error, cases in REFUSED.items() for case in cases],
)
def test_what_is_not_clear_is_refused(error, header, options, sentence):
    """The sentence names the columns, and the options that settle it."""
    with pytest.raises(error) as caught:
        chosen(header_of(header), **options)
    assert sentence in str(caught.value)


@pytest.mark.parametrize("labels", [("left", "right"), ("thigh", "shank", "foot"), ("1", "2")])
@pytest.mark.parametrize("name", ["{}_gyro_{}", "{}.gyro.{}", "gyro_{1}_{0}_dps", "imu_{}_gyro_{}"])
def test_of_several_sensors_in_one_table_one_is_chosen_by_its_name(name, labels):
    """The refusal offers the words that tell them apart; each of them reads its own columns."""
    columns = ",".join(name.format(label, axis) for label in labels for axis in "xyz")
    text = f"t_ns,{columns}\n1,{','.join(map(str, range(3 * len(labels))))}\n"
    offered = " or ".join(map(repr, labels))
    unit = {} if "dps" in name else {"rate_unit": "deg/s"}
    assert refusal(text, UndeclaredError, **unit).endswith(f"with series={offered}")
    for k, label in enumerate(labels):
        found = table_rates(text, series=label, **unit)
        assert np.degrees(found.rate).round(12).tolist() == [[3 * k, 3 * k + 1, 3 * k + 2]]


def test_measured_rates_come_before_estimated_ones():
    """In a file as in messages: those of an odometry do not compete, and are named."""
    estimated = ",".join(f"twist.twist.angular.{axis}" for axis in "xyz")
    header = f"header.stamp.sec,header.stamp.nanosec,{estimated}"
    measured = ",".join(f"imu.angular_velocity.{axis}" for axis in "xyz")
    assert table_rates(f"{header}\n1,2,3,4,5\n").rate.tolist() == [[3, 4, 5]]
    both = table_rates(f"{header},{measured}\n1,2,3,4,5,6,7,8\n")
    assert both.rate.tolist() == [[6, 7, 8]]
    assert both.remarks == [f"ignored estimated body rates: '{estimated}'"]


DPS = "t_ns,gyro_x_dps,gyro_y_dps,gyro_z_dps"
OF_DPS = "'gyro_x_dps', 'gyro_y_dps', 'gyro_z_dps' are in deg/s"
MIXED_UNITS = "'wx_rad_s', 'wy_rad_s' are in rad/s and 'wz_deg_s' is in deg/s"


@pytest.mark.parametrize(
    ("header", "options", "facts"),
    [
        (DPS, {"rate_unit": "rad/s"}, OF_DPS),
        (DPS, {"rate_unit": "rad/s", "rate_cols": ("1", "2", "3")}, OF_DPS),
        ("t_s,wx_rad_s,wy_rad_s,wz_deg_s", {"rate_unit": "rad/s"}, MIXED_UNITS),
        ("t_s,wx_rad_s,wy,wz", {"rate_unit": "deg/s"}, "'wx_rad_s' is in rad/s"),
        (DPS, {"time_unit": "us"}, "'t_ns' is in ns"),
    ],
)
def test_a_unit_that_the_user_gives_overrules_the_header(header, options, facts):
    """As it does the definition of a message; the remark says what the header has."""
    found = table_rates(f"{header}\n1,2,3,4\n", **options)
    name, unit = next(iter(options.items()))
    assert found.remarks == [
        f"{name} says {unit}, but by header or convention {facts}; read in {unit}, as requested"
    ]
    factor = RATES[options.get("rate_unit", "deg/s")]
    assert found.rate.tolist() == [[2 * factor, 3 * factor, 4 * factor]]
    assert found.t_ns == [NS[options.get("time_unit", header[2:].split(",")[0])]]


@pytest.mark.parametrize(
    ("unit", "read_as", "scale"),
    [
        ("mdps", "deg/s", 1e-3),
        ("mrad/s", "rad/s", 1e-3),
        ("deg/h", "deg/s", 1 / 3600),
        ("rpm", "deg/s", 6.0),
    ],
)
def test_other_units_of_rates_are_multiplied_and_remarked_on(unit, read_as, scale):
    """They are read as one of the two units of rates, unless the user says that they are it."""
    text = f"t_ns,G_x [{unit}],G_y [{unit}],G_z [{unit}]\n0,1,2,3\n"
    found = table_rates(text)
    np.testing.assert_allclose(found.rate, [np.arange(1, 4) * scale * RATES[read_as]], rtol=1e-15)
    assert found.remarks == [f"the rates are in {unit}, which is read as {scale:.4g} {read_as}"]
    (remark,) = table_rates(text, rate_unit="rad/s").remarks
    assert f"are in {unit}; read in rad/s, as requested" in remark


@pytest.mark.parametrize(("clock", "column"), [("log", 0), ("header", 2)])
def test_the_log_clock_of_rostopic_is_its_first_column(clock, column):
    """With clock='log' the time of recording is taken instead of the message's stamp."""
    header = header_of("%time,field.header.seq,field.header.stamp,field.angular_velocity.{xyz}")
    assert chosen(header, clock=clock)[1] == [column + 1]


@pytest.mark.parametrize(
    ("names", "time_col"),
    [
        # `ros2 topic echo --csv` has no header.
        ("", "0,1"),
        ("stamp.secs,stamp.usecs", None),
        ("tv_sec,tv_usec", "tv_sec"),
        ("tv_sec,tv_usec", "tv_sec,tv_usec"),
        ("t_sec,micros", "t_sec,micros"),
        ("sec,msec", None),
        ("seconds,milliseconds", "seconds,milliseconds"),
        ("time_s,time_ms", "time_s,time_ms"),
        ("t (s),t (ms)", "t (s),t (ms)"),
    ],
)
def test_parts_of_a_second_have_the_unit_of_their_name(names, time_col):
    """As the time functions of C have them; the second part of a stamp need not be in ns."""
    part = 10 if "ms" in names or "milli" in names else 10_000 if names else 10_000_000
    rows = "".join(f"1700000000,{part * k},1,2,3\n" for k in range(3))
    named = {} if names else {"rate_cols": ("2", "3", "4"), "rate_unit": "rad/s"}
    text = f"{names},gx_dps,gy_dps,gz_dps\n{rows}" if names else rows
    t_ns = table_rates(text, time_col=time_col, **named).t_ns
    assert t_ns == [1_700_000_000 * 10**9 + k * 10**7 for k in range(3)]


@pytest.mark.parametrize("name", ["usec", "msec"])
@pytest.mark.parametrize("seconds", ["{}.01", "{}"])
def test_seconds_are_not_added_to_a_clock_next_to_them(name, seconds):
    """Each column is the whole time then; the one that is named is taken alone."""
    per_second = {"usec": 10**6, "msec": 10**3}[name]
    rows = "".join(f"{seconds.format(k)},{k * per_second},1,2,3\n" for k in range(3))
    text = f"sec,{name},gx_dps,gy_dps,gz_dps\n{rows}"
    assert f"the time column (one of 'sec', '{name}')" in refusal(text, UndeclaredError)
    t_ns = table_rates(text, time_col="sec", time_unit="s").t_ns
    assert np.diff(t_ns).tolist() == [10**9] * 2
    t_ns = table_rates(text, time_col=name, time_unit=name[:1] + "s").t_ns
    assert t_ns == [0, 10**9, 2 * 10**9]


@pytest.mark.parametrize("mark", ["covariance0", "covariance[0]", "covariance.0"])
def test_rates_that_a_covariance_marks_as_absent_are_not_used(mark):
    """As in the message that became the row: there is no gyroscope, whatever stands in it."""
    names = ",".join(f"angular_velocity.{axis}" for axis in "xyz")
    header = f"header.stamp.sec,header.stamp.nanosec,{names},angular_velocity_{mark}"
    found = table_rates(f"{header}\n1,0,1,2,3,0.5\n2,0,0,0,0,-1\n")
    assert found.t_ns == [10**9, 2 * 10**9]
    np.testing.assert_array_equal(found.rate, [[1, 2, 3], 3 * [np.nan]])


def test_rates_about_axes_that_nobody_knows_are_named_by_the_user():
    """OpenRocket's pitch and yaw rates are about axes that follow the airflow, not the body."""
    _, t_ns, rate = chosen(ANGLES, rate_cols=("Roll rate", "Pitch rate", "Yaw rate"))
    assert (t_ns, rate.tolist()) == ([10**9], [k * RATES["deg/s"] for k in (2, 3, 4)])


MVN = ["{segment} {quantity} ", "Segment {quantity} {segment} "]


@pytest.mark.thorough
@pytest.mark.parametrize("spelled", MVN)
@pytest.mark.parametrize("segment", ["Pelvis", "T8", "Right Upper Arm", "Left Toe"])
@pytest.mark.parametrize("unit", ["", " [rad/s]", " [deg/s]"])
def test_rates_of_a_segment_of_mvn_are_about_axes_of_the_world(tmp_path, spelled, segment, unit):
    """They were read as rates of the body, and the orientation beside them was not seen."""
    t_ns = np.arange(600) * 10**7
    rate = np.random.default_rng(4).normal(0, 1, 3) + np.sin(t_ns[:, None] / 1e9 * [1, 1.7, 2.3])
    found = propagate(GyroSeries(t_ns, rate), rates="inertial", method="cubic")
    orientation, velocity = (
        spelled.format(segment=segment, quantity=one) for one in ("Orientation", "Angular Velocity")
    )
    columns = {"Frame": range(600), "Time [s]": t_ns / 1e9}
    columns |= {f"{orientation}q{k}": found.wxyz[:, k] for k in range(4)}
    scale = RATES["deg/s"] if "deg" in unit else 1
    columns |= {f"{velocity}{axis}{unit}": rate[:, k] / scale for k, axis in enumerate("xyz")}
    path = tmp_path / "log.csv"
    pd.DataFrame(columns).to_csv(path, index=False)
    said = refusal(path, UndeclaredError)
    assert "are about axes of the body or of 'world' is not declared; specify it with " in said
    assert "specify it with rates='inertial' if of the latter, else with rate_cols='" in said
    read = propagate(path, rates="inertial", method="cubic")
    assert np.abs((read.wxyz * found.wxyz).sum(axis=1)).min() > 1 - 1e-9
    with pytest.warns(RemarkWarning, match="contradict the log's own orientation.*'inertial'"):
        propagate(path, rate_cols=tuple(f"{velocity}{axis}{unit}" for axis in "xyz"))


def test_a_sensor_on_the_pelvis_is_not_mvn():
    """It is spelled otherwise, and its rates are those of the body."""
    names = ",".join(f"pelvis_angular_velocity_{axis}_rad_s" for axis in "xyz")
    assert table_rates(f"time_s,{names}\n0,1,2,3\n1,1,2,3\n").rate.tolist() == [[1, 2, 3]] * 2


@pytest.mark.parametrize("header", ["g{axis}_rads", "gyro_{axis} (rads)", "gyro_{axis}_degs"])
def test_a_unit_of_angles_in_the_name_of_a_rate_is_overruled_as_the_refusal_says(header):
    """`rads` is often written for rad/s, and there is nothing to convert."""
    names = ",".join(header.format(axis=axis) for axis in "xyz")
    text = f"time_s,{names}\n0,1,2,3\n1,1,2,3\n"
    unit = "rad/s" if "rads" in header else "deg/s"
    assert "name that with rate_unit='rad/s' or 'deg/s'" in refusal(text)
    found = table_rates(text, rate_unit=unit)
    np.testing.assert_allclose(found.rate[0], np.array([1, 2, 3]) * RATES[unit])


@pytest.mark.parametrize("unit", ["\u00b0/s", "\u00ba/s", "\u00b0/sec", "m\u00b0/s"])
def test_a_degree_sign_read_in_a_wrong_encoding_is_one(unit):
    """A program took UTF-8 for Latin-1, and wrote what it saw as UTF-8."""
    text = (
        ",".join(["time_s", *(f"gyro_{axis} [{unit}]" for axis in "xyz")]) + "\n0,1,2,3\n1,1,2,3\n"
    )
    garbled = text.encode().decode("latin-1")
    assert garbled != text
    np.testing.assert_array_equal(table_rates(garbled).rate, table_rates(text).rate)
