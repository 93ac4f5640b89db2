"""Column names to time, rates and units: known conventions, clear names, options."""

from pathlib import Path

import numpy as np
import pytest

from quatprop import read_rates
from quatprop.errors import NoRatesError, UndeclaredError, UnsupportedLogError, UsageError
from quatprop.logs.matching.find import find
from quatprop.logs.signals.rate_columns import match_rates
from quatprop.settings.quantities import RATES
from quatprop.settings.selection import RateSelection
from quatprop.settings.spelling import in_options
from quatprop.tables.base import TableLog
from quatprop.tables.column_names import parse_name
from quatprop.tables.model import Stamp, TableNotes

AXES = ("wx", "wy", "wz")
NAMED = {"rate_cols": ("x", "y", "z"), "time_col": "t", "rate_unit": "rad/s", "time_unit": "us"}

KNOWN = {
    "t_ns,wx,wy,wz": ("quatprop", (1, 2, 3), "rad/s", (0,), "ns"),
    "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1]": (
        *("EuRoC", (1, 2, 3), "rad/s", (0,), "ns"),
    ),
    "timestamp,gyro_rad[0],gyro_rad[1],gyro_rad[2],gyro_integral_dt": (
        *("PX4 ulog2csv", (1, 2, 3), "rad/s", (0,), "us"),
    ),
    "timestamp,timestamp_sample,xyz[0],xyz[1],xyz[2],xyz_derivative[0]": (
        *("PX4 ulog2csv", (2, 3, 4), "rad/s", (1,), "us"),
    ),
    "timestamp,timestamp_sample,device_id,x,y,z,temperature,error_count,samples": (
        *("PX4 ulog2csv", (3, 4, 5), "rad/s", (1,), "us"),
    ),
    "timestamp,rollspeed,pitchspeed,yawspeed,q[0],q[1],q[2],q[3]": (
        *("PX4 ulog2csv", (1, 2, 3), "rad/s", (0,), "us"),
    ),
    "%time,field.header.seq,field.header.stamp,field.angular_velocity.x,field.angular_velocity.y,"
    "field.angular_velocity.z,field.angular_velocity_covariance0": (
        *("rostopic echo -p", (3, 4, 5, 6), "rad/s", (2,), "ns"),
    ),
    "header.stamp.sec,header.stamp.nanosec,angular_velocity.x,angular_velocity.y,"
    "angular_velocity.z": ("ROS messages as columns", (2, 3, 4), "rad/s", (0, 1), "s"),
    "Time,header.seq,header.stamp.secs,header.stamp.nsecs,angular_velocity.x,angular_velocity.y,"
    "angular_velocity.z": ("ROS messages as columns", (4, 5, 6), "rad/s", (2, 3), "s"),
    "Time (s),Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s),Accelerometer X (g)": (
        *("x-io", (1, 2, 3), "deg/s", (0,), "s"),
    ),
    "Time (s),Gyroscope x (rad/s),Gyroscope y (rad/s),Gyroscope z (rad/s),Absolute (rad/s)": (
        *("phyphox", (1, 2, 3), "rad/s", (0,), "s"),
    ),
    "t_s,gx_dps,gy_dps,gz_dps": ("", (1, 2, 3), "deg/s", (0,), "s"),
    "t_s,imu_gx_rad_s,imu_gy_rad_s,imu_gz_rad_s": ("", (1, 2, 3), "rad/s", (0,), "s"),
    "t_ms,wx_mdeg_s,wy_mdeg_s,wz_mdeg_s": ("", (1, 2, 3), "deg/s", (0,), "ms"),
    "Timestamp (us),Gyroscope X (deg/s),Gyroscope Y (deg/s),Gyroscope Z (deg/s)": (
        *("x-io", (1, 2, 3), "deg/s", (0,), "us"),
    ),
    "time_ms,gyro_x_dps,gyro_y_dps,gyro_z_dps": ("", (1, 2, 3), "deg/s", (0,), "ms"),
    "T [\u00b0C],timestamp_ms,gx_dps,gy_dps,gz_dps": ("", (2, 3, 4), "deg/s", (1,), "ms"),
    "t [s];omega_z [rad/s];omega_y [rad/s];omega_x [rad/s]": ("", (3, 2, 1), "rad/s", (0,), "s"),
    "timestamp,TimeUS,I,GyrX,GyrY,GyrZ,AccX,T": ("ArduPilot", (3, 4, 5), "rad/s", (1,), "us"),
    "loopIteration,time (us),axisP[0],gyroADC[0],gyroADC[1],gyroADC[2]": (
        *("Betaflight", (3, 4, 5), "deg/s", (1,), "us"),
    ),
    "# UncalGyro,utcTimeMillis,elapsedRealtimeNanos,UncalGyroXRadPerSec,UncalGyroYRadPerSec,"
    "UncalGyroZRadPerSec,DriftXRadPerSec,DriftYRadPerSec,DriftZRadPerSec": (
        *("Android GnssLogger", (3, 4, 5), "rad/s", (2,), "ns"),
    ),
    "time,seconds_elapsed,rotationRateX,rotationRateY,rotationRateZ,gravityX": (
        *("Sensor Logger", (2, 3, 4), "rad/s", (0,), "ns"),
    ),
    "Zeit (s);Gyroskop x (rad/s);Gyroskop y (rad/s);Gyroskop z (rad/s)": (
        *("", (1, 2, 3), "rad/s", (0,), "s"),
    ),
    "UTC time (s),time ITOW,xRate (deg/s),yRate (deg/s),zRate (deg/s)": (
        *("", (2, 3, 4), "deg/s", (0,), "s"),
    ),
    "timestampNs,userRotationRateX(rad/s),userRotationRateY(rad/s),userRotationRateZ (rad/s)": (
        "",
        (1, 2, 3),
        "rad/s",
        (0,),
        "ns",
    ),
    "time_boot_ms,X_GYRO_OUT [deg/s],Y_GYRO_OUT [deg/s],Z_GYRO_OUT [deg/s],exposure (us)": (
        *("", (1, 2, 3), "deg/s", (0,), "ms"),
    ),
    "__time (s),p (deg/s),q (deg/s),r (deg/s)": ("", (1, 2, 3), "deg/s", (0,), "s"),
    "time_s,p_rad_s,q_rad_s,r_rad_s": ("", (1, 2, 3), "rad/s", (0,), "s"),
    "t [s],\u03c9x [rad\u00b7s\u207b\u00b9],\u03c9y [rad\u00b7s\u207b\u00b9],\u03c9z [rad s-1]": (
        *("", (1, 2, 3), "rad/s", (0,), "s"),
    ),
    "timestamp[ns],w.x,w.y,w.z,a.x,a.y,a.z": ("TUM-VI", (1, 2, 3), "rad/s", (0,), "ns"),
    "graph_uid,tracking_timestamp_us,utc_timestamp_ns,qx_world_device,qy_world_device,"
    "qz_world_device,qw_world_device,angular_velocity_x_device,angular_velocity_y_device,"
    "angular_velocity_z_device": ("Project Aria", (7, 8, 9), "rad/s", (1,), "us"),
    "t_ms,aX,aY,aZ,gX_dps,gY_dps,gZ_dps": ("", (4, 5, 6), "deg/s", (0,), "ms"),
    "t (s),gx (degrees per second),gy (degrees per second),gz (degrees per second)": (
        *("", (1, 2, 3), "deg/s", (0,), "s"),
    ),
}

FILES = {"xyz[0]": "a_vehicle_angular_velocity_0.csv", ",device_id,": "a_sensor_gyro_0.csv"}
"""Names of files that a convention goes by, and a part of the header of each."""


def chosen(header, name="log.csv", notes=None, **options):
    """Choose the columns of a header line."""
    names = header.split(";" if ";" in header else ",")
    (found,) = find(table_of(names, name, notes), "rate")
    return match_rates(found, RateSelection(**options))


def table_of(names, name="log.csv", notes=None):
    """Return a file without rows."""
    return NoRows(Path(name), names, notes or TableNotes())


class NoRows(TableLog):
    """A file of columns without rows."""

    kind = "csv"
    notes = names = None

    def __init__(self, path, names, notes):
        super().__init__(path)
        self.names, self.notes = names, notes

    def _stored_rows(self, _columns):
        return iter(())


def matched(columns):
    """Return what is said of the columns of a table: where they are, and their units."""
    numbers, stamp = (*columns.sets[0], *columns.marks), columns.stamp
    units = (*stamp.units, "ns")
    return numbers, columns.unit, stamp.columns, units[0], columns.row.name


@pytest.mark.parametrize("header", KNOWN)
def test_a_header_that_names_columns_and_units_needs_no_options(header):
    """Every convention is recognised with its columns, its units and its name."""
    dialect, *columns = KNOWN[header]
    name = next((name for sign, name in FILES.items() if sign in header), "log.csv")
    assert matched(chosen(header, name)) == (*columns, dialect)


def test_the_reversed_columns_of_a_phone_are_taken_by_name():
    """Sensor Logger writes z, y, x; the order of the rates is still x, y, z."""
    found = chosen("time,seconds_elapsed,z,y,x", "Gyroscope.csv")
    assert matched(found) == ((4, 3, 2), "rad/s", (0,), "ns", "Sensor Logger")


def test_the_accelerometer_of_a_phone_is_not_taken_for_a_gyroscope():
    """The same header in a file that is not called a gyroscope carries no rates."""
    with pytest.raises(NoRatesError, match="its columns are 'time', 'seconds_elapsed', 'z'"):
        chosen("time,seconds_elapsed,z,y,x", "Accelerometer.csv")


def test_gcsv_times_and_rates_are_scaled_as_its_keys_say():
    """A gcsv table takes its time unit from tscale and its rate factor from gscale."""
    notes = TableNotes(units={0: "ms"}, rate_scale=0.5, title="GYROFLOW IMU LOG")
    found = chosen("t,gx,gy,gz", notes=notes)
    assert matched(found) == ((1, 2, 3), "rad/s", (0,), "ms", "gcsv")
    assert found.factor == 0.5


def test_a_turned_sensor_of_a_gcsv_is_remarked_on():
    """Its rates are taken as they are, and the mounting that turns them is named."""
    notes = TableNotes(units={0: "ms"}, title="GYROFLOW IMU LOG", mount="y,-x,z")
    (remark,) = chosen("t,gx,gy,gz", notes=notes).remarks
    assert in_options(remark) == (
        "the file says how its sensor is mounted, and rates are taken as they are; to turn them "
        "into the camera's axes use --mount y,-x,z"
    )


def test_a_left_handed_orientation_of_a_gcsv_is_not_proposed():
    """It is no rotation, and --mount would refuse it."""
    notes = TableNotes(units={0: "ms"}, title="GYROFLOW IMU LOG", mount="x,y,-z")
    (remark,) = chosen("t,gx,gy,gz", notes=notes).remarks
    assert in_options(remark) == (
        "the file says how its sensor is mounted, and rates are taken as they are; as the mounting "
        "x,y,-z is left-handed, it cannot be right"
    )


def test_stamps_that_a_sample_rate_replaces_are_named():
    """Rows are counted as asked, and the stamps beside them are not passed over in silence."""
    found = chosen("time,wx,wy,wz", sample_rate=200.0, rate_unit="rad/s")
    assert (found.stamp.columns, found.stamp.sample_rate) == ((), 200.0)
    assert [in_options(remark) for remark in found.remarks] == [
        "--sample-rate 200 counts the rows; the stamps in 'time' are not used",
    ]
    assert chosen("wx,wy,wz", sample_rate=200.0, rate_unit="rad/s").remarks == ()


def test_averages_of_px4_want_the_method_end():
    """sensor_combined holds averages over the interval before each stamp."""
    header = "timestamp,gyro_rad[0],gyro_rad[1],gyro_rad[2],gyro_integral_dt"
    assert chosen(header).row.method == "end"
    assert chosen("#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y,w_RS_S_z").row.method is None


def test_gx_alone_needs_a_unit():
    """The name gx may be gravity, so without the gcsv title it is not taken before one is said."""
    sentence = (
        "log.csv: the unit of the rates 'gx', 'gy', 'gz' and the unit of the time 't' are not "
        "declared; say them with rate_unit='rad/s' or 'deg/s' and time_unit='s' or 'ms' or 'us' "
        "or 'ns'"
    )
    with pytest.raises(UndeclaredError) as caught:
        chosen("t,gx,gy,gz")
    assert str(caught.value) == sentence


@pytest.mark.parametrize(
    ("header", "numbers"),
    [
        ("t_s,gx,gy,gz", (1, 2, 3)),
        ("t_s,aX,aY,aZ,gX,gY,gZ", (4, 5, 6)),
        ("t_s,AX,AY,AZ,GX,GY,GZ", (4, 5, 6)),
        ("t_s,ax,ay,az,gx,gy,gz,mag_x,mag_y,mag_z,temp", (4, 5, 6)),
        ("t_s,p,q,r", (1, 2, 3)),
    ],
)
def test_gx_and_p_are_rates_where_the_user_declares_the_unit_of_rates(header, numbers):
    """Beside an accelerometer or a magnetometer they cannot be meant otherwise."""
    found = chosen(header, rate_unit="deg/s")
    assert matched(found) == (numbers, "deg/s", (0,), "s", "")


@pytest.mark.parametrize(
    "header",
    ["t_s,gx,gy,gz,turn_x,turn_y,turn_z", "t_s,qw,qx,qy,qz,gx,gy,gz", "t_s,gx,gy,gz,p,q,r"],
)
def test_gx_beside_other_axes_may_be_gravity(header):
    """It is not taken, even where the unit of rates is declared."""
    with pytest.raises(NoRatesError, match="name the columns with rate_cols and time_col"):
        chosen(header, rate_unit="deg/s")


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
        ("Gyro-X (d/s)", "gyro_x", "d/s"),
        ("wx (degree/sec)", "wx", "deg/s"),
        ("wx [\u00b0 / seconds]", "wx", "deg/s"),
        ("wx (Rads/s)", "wx", "rad/s"),
        ("wx (rad\u00b7s\u22121)", "wx", "rad/s"),
        ("wx (rad/s^2)", "wx", "rad/s^2"),
        ("q (degrees)", "q", "deg"),
    ],
)
def test_a_name_is_taken_apart(text, key, unit):
    """Marks, case, brackets and unit suffixes are separated from the name proper."""
    found = parse_name(text)
    assert (found.text, found.key, found.unit) == (text, key, unit)


def test_units_that_are_not_declared_are_asked_for():
    """Clear names without units are refused with both options that settle them."""
    with pytest.raises(UndeclaredError) as error:
        chosen("t,frame_id,gyro_x,gyro_y,gyro_z")
    assert str(error.value) == (
        "log.csv: the unit of the rates 'gyro_x', 'gyro_y', 'gyro_z' and the unit of the time 't' "
        "are not declared; say them with rate_unit='rad/s' or 'deg/s' and time_unit='s' or 'ms' or "
        "'us' or 'ns'"
    )


def test_options_declare_what_the_header_does_not():
    """With both units said, clear names are enough."""
    found = chosen("t,frame_id,gyro_x,gyro_y,gyro_z", rate_unit="deg/s", time_unit="s")
    assert matched(found) == ((2, 3, 4), "deg/s", (0,), "s", "")


def test_several_possible_times_are_listed():
    """Two columns that may be the time are refused with their names."""
    with pytest.raises(UndeclaredError, match=r"the time column \(one of 'a_t', 'b_t'\)"):
        chosen("a_t,b_t,gyro_x,gyro_y,gyro_z")


def test_measured_rates_come_before_estimated_ones():
    """In a file as in messages: those of an odometry do not compete, and are named."""
    estimated = [f"twist.twist.angular.{axis}" for axis in "xyz"]
    header = ["header.stamp.sec", "header.stamp.nanosec", *estimated]
    assert chosen(",".join(header)).field == ",".join(estimated)
    both = chosen(",".join([*header, *(f"imu.angular_velocity.{axis}" for axis in "xyz")]))
    assert both.field == ",".join(f"imu.angular_velocity.{axis}" for axis in "xyz")
    assert both.remarks == (f"ignored estimated body rates: '{','.join(estimated)}'",)


def test_several_sets_of_rates_are_refused():
    """Two gyroscopes in one table are ambiguous until the columns are named."""
    header = "t,a.gyro_x,a.gyro_y,a.gyro_z,b.gyro_x,b.gyro_y,b.gyro_z"
    with pytest.raises(UndeclaredError, match=r"are 'a.gyro_x', 'b.gyro_x'.*rate_cols='X,Y,Z'"):
        chosen(header)


@pytest.mark.parametrize(
    "names", [("wx (rad/s)", "gx (deg/s)"), ("wx", "gx_dps"), ("wx", "x_gyro")]
)
def test_a_second_gyroscope_under_other_names_is_not_passed_over(names):
    """What is one by name is not preferred to what is one by unit; the one named is taken."""
    axes = [name.replace("x", axis) for name in names for axis in "xyz"]
    with pytest.raises(UndeclaredError) as error:
        chosen(",".join(("t_ns", *axes)))
    assert f"their x columns are '{names[0]}', '{names[1]}') is not" in str(error.value)
    second = chosen(",".join(("t_ns", *axes)), rate_cols=("4", "5", "6"), rate_unit="deg/s")
    assert matched(second) == ((4, 5, 6), "deg/s", (0,), "ns", "")


@pytest.mark.parametrize(
    ("header", "sets"),
    [
        ("t_ns,wx,wy,wz,wx,wy,wz", "1-2-3, 4-5-6"),
        ("t_ns,wx,wy,wz,wz", "1-2-3, 1-2-4"),
        ("t_ns,gyro_x_dps,gyro_y_dps,gyro_z_dps,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s", ""),
    ],
)
def test_the_same_names_twice_are_refused(header, sets):
    """Nothing tells which of them is meant but their numbers."""
    with pytest.raises(UndeclaredError, match=f"which set of rates to use .*{sets}.*rate_cols="):
        chosen(header)
    assert chosen(header, rate_cols=("1", "2", "3")).sets == ((1, 2, 3),)


def test_a_column_is_not_both_a_rate_and_the_time():
    """A number that names the time column among the rates is a mistake."""
    with pytest.raises(UsageError, match="'t_ns' cannot be both the time and one of rate_cols"):
        chosen("t_ns,wx,wy,wz", rate_cols=("0", "2", "1"), rate_unit="rad/s")


@pytest.mark.parametrize("name", ["b_w_RS_S_{}", "b_w_RS_S_{} [rad s^-1]", "bias_gyro_{}"])
def test_biases_are_not_rates(name):
    """A gyroscope's bias, variance or noise is not its rate."""
    with pytest.raises(NoRatesError):
        chosen(",".join(("t", *(name.format(axis) for axis in "xyz"))))


@pytest.mark.parametrize("cols", [("x", "y", "z"), ("1", "2", "3"), ("X", "#y", "z [rad/s]")])
def test_columns_are_named_by_name_or_number(cols):
    """An option finds a column as it is spelled, by its bare name, or by its number from 0."""
    found = chosen("t,x,y,z", **{**NAMED, "rate_cols": cols})
    assert matched(found) == ((1, 2, 3), "rad/s", (0,), "us", "")


def test_a_name_wins_over_a_number():
    """A column called "1" is found by its name, not as the second column."""
    found = chosen("1,2,3,0", **{**NAMED, "rate_cols": ("1", "2", "3"), "time_col": "0"})
    assert (found.sets, found.stamp.columns) == (((0, 1, 2),), (3,))


def test_a_column_that_is_not_there_is_told_with_those_that_are():
    """Naming a column that does not exist is an error that lists the columns."""
    with pytest.raises(UsageError, match="rate_cols asks for column 'w'; the columns are 't', 'x'"):
        chosen("t,x,y,z", **{**NAMED, "rate_cols": ("w", "y", "z")})


def test_a_name_that_two_columns_share_is_refused():
    """A repeated name has to be told by number."""
    with pytest.raises(UsageError, match="2 columns are called 'x'; say which with its number"):
        chosen("t,x,x,y,z", **NAMED)


def test_a_unit_that_the_user_gives_overrules_the_header():
    """As it does the definition of a message; the remark says what the header has."""
    header = "t_ns,gyro_x_dps,gyro_y_dps,gyro_z_dps"
    for options in ({}, {"rate_cols": ("gyro_x_dps", "gyro_y_dps", "gyro_z_dps")}):
        found = chosen(header, rate_unit="rad/s", **options)
        assert (found.unit, found.factor) == ("rad/s", 1.0)
        (remark,) = found.remarks
        assert in_options(remark) == (
            "--rate-unit says rad/s, but by header or convention 'gyro_x_dps', 'gyro_y_dps', "
            "'gyro_z_dps' are in deg/s; read in rad/s, as asked for"
        )
    assert chosen(header, time_unit="us").stamp.units == ("us",)


def test_columns_in_different_units_are_refused():
    """One unit read for all would be wrong for some, unless the user says it."""
    header = "t_s,wx_rad_s,wy_rad_s,wz_deg_s"
    facts = "by header or convention 'wx_rad_s', 'wy_rad_s' are in rad/s and 'wz_deg_s' is in deg/s"
    with pytest.raises(UsageError, match=f": {facts}; convert them to one unit$"):
        chosen(header)
    given = chosen(header, rate_unit="rad/s")
    assert f" says rad/s, but {facts}; read in rad/s" in str(given.remarks[0])


def test_a_unit_against_that_of_one_column_is_remarked_on():
    """A unit that the header declares of one column alone counts too."""
    (remark,) = chosen("t_s,wx_rad_s,wy,wz", rate_unit="deg/s").remarks
    assert "convention 'wx_rad_s' is in rad/s; read in deg/s, as asked for" in str(remark)


def test_a_unit_of_another_kind_is_refused_by_name():
    """A header that declares a unit this version does not know is not read as another."""
    with pytest.raises(
        UnsupportedLogError, match=r"declared in 'counts'; convert them to rad/s or deg/s$"
    ):
        chosen("t_ns,Gyr_X [counts],Gyr_Y [counts],Gyr_Z [counts]")


@pytest.mark.parametrize(
    ("unit", "read_as", "scale"),
    [("mdps", "deg/s", 1e-3), ("mrad/s", "rad/s", 1e-3), ("deg/h", "deg/s", 1 / 3600),
     ("rpm", "deg/s", 6.0)],
)  # fmt: skip
def test_other_units_of_rates_are_multiplied_and_remarked_on(unit, read_as, scale):
    """They are read as one of the two units of rates, unless the user says that they are it."""
    header = ",".join(["t_ns", *(f"G_{axis} [{unit}]" for axis in "xyz")])
    found = chosen(header)
    assert (found.unit, found.factor) == (read_as, pytest.approx(scale * RATES[read_as], rel=1e-15))
    assert found.remarks == (f"the rates are in {unit}, which is read as {scale:.4g} {read_as}",)
    (remark,) = chosen(header, rate_unit="rad/s").remarks
    assert f"are in {unit}; read in rad/s, as asked for" in str(remark)


@pytest.mark.parametrize("note", ["drift", "bias", "cov", "error"])
def test_axes_that_are_no_rates_are_not_taken_for_them(note):
    """The unit of a rate does not make one of what describes a rate."""
    with pytest.raises(NoRatesError):
        chosen(",".join(["t_ns", *(f"{note}_{axis} [rad/s]" for axis in "xyz")]))


def test_seconds_and_nanoseconds_may_be_named(tmp_path):
    """`ros2 topic echo --csv` has no header, and its stamp is two columns."""
    path = tmp_path / "echo.csv"
    path.write_text("".join(f"1700000000,{k}0000000,imu,0.1,0.2,0.3\n" for k in range(1, 9)))
    rates = read_rates(path, rate_cols=["3", "4", "5"], time_col="0,1", rate_unit="rad/s")
    assert (rates.t_ns - 1_700_000_000_000_000_000).tolist() == [k * 10**7 for k in range(1, 9)]


def test_a_declared_sample_rate_stands_in_for_a_time_column():
    """A counter is not a time; the rate in the comments is."""
    found = chosen(
        "Counter,Gyr_X,Gyr_Y,Gyr_Z", notes=TableNotes(sample_rate=50.0), rate_unit="rad/s"
    )
    assert matched(found) == ((1, 2, 3), "rad/s", (), "ns", "")
    assert found.stamp == Stamp(clock="50 Hz", sample_rate=50.0)


def test_a_sample_rate_said_wins_over_a_time_column():
    """Rows are counted where the user says so."""
    found = chosen("t_ns,wx,wy,wz", sample_rate=200.0)
    assert (found.stamp.columns, found.stamp.sample_rate) == ((), 200.0)


@pytest.mark.parametrize("sample_rate", [0.0, -1.0, float("nan"), float("inf")])
def test_a_sample_rate_is_above_zero(sample_rate):
    """A sample rate that is not a positive number is refused."""
    with pytest.raises(UsageError, match="is not a rate above 0 Hz"):
        chosen("t_ns,wx,wy,wz", sample_rate=sample_rate)


def test_sample_rate_and_time_column_contradict():
    """Only one of the two can say when a row was taken."""
    with pytest.raises(UsageError, match="time_col and sample_rate contradict each other"):
        chosen("t_ns,wx,wy,wz", sample_rate=200.0, time_col="t_ns")


def test_the_log_clock_of_rostopic_is_its_first_column():
    """With clock='log' the time of recording is taken instead of the message's stamp."""
    header = next(header for header in KNOWN if header.startswith("%time"))
    assert chosen(header, clock="log").stamp.columns == (0,)
    assert chosen(header, clock="header").stamp.columns == (2,)


def test_a_clock_that_a_table_does_not_have_is_refused():
    """Tables know no publish time, and most know no time of recording."""
    with pytest.raises(UsageError, match="this table has no publish time"):
        chosen("t_ns,wx,wy,wz", clock="publish")


def test_a_topic_is_refused(tmp_path):
    """A table has no topics; saying one is a mistake worth telling."""
    path = tmp_path / "log.csv"
    path.write_text("t_ns,wx,wy,wz\n0,0,0,0\n1,0,0,0\n")
    with pytest.raises(UsageError, match="topic is for logs of messages and this is a table"):
        read_rates(path, topic="/imu")


@pytest.mark.parametrize(
    ("names", "time_col"),
    [
        ("sec,usec", None),
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
def test_parts_of_a_second_have_the_unit_of_their_name(tmp_path, names, time_col):
    """As the time functions of C have them; the second part of a stamp need not be in ns."""
    path = tmp_path / "log.csv"
    parts = 10 if "ms" in names or "milli" in names else 10_000
    rows = "".join(f"1700000000,{parts * k},1,2,3\n" for k in range(3))
    path.write_text(f"{names},gx_dps,gy_dps,gz_dps\n{rows}")
    rates = read_rates(path, time_col=time_col)
    assert (rates.t_ns - 1_700_000_000 * 10**9).tolist() == [0, 10_000_000, 20_000_000]


@pytest.mark.parametrize("name", ["usec", "msec"])
@pytest.mark.parametrize("seconds", ["{}.01", "{}"])
def test_seconds_are_not_added_to_a_clock_beside_them(tmp_path, name, seconds):
    """Each column is the whole time then; the one that is named is taken alone."""
    path = tmp_path / "log.csv"
    per_second = {"usec": 10**6, "msec": 10**3}[name]
    rows = "".join(f"{seconds.format(k)},{k * per_second},1,2,3\n" for k in range(3))
    path.write_text(f"sec,{name},gx_dps,gy_dps,gz_dps\n{rows}")
    with pytest.raises(UndeclaredError, match=rf"the time column \(one of 'sec', '{name}'\)"):
        read_rates(path)
    t_ns = read_rates(path, time_col="sec", time_unit="s").t_ns
    assert np.diff(t_ns).tolist() == [10**9] * 2
    t_ns = read_rates(path, time_col=name, time_unit=name[:1] + "s").t_ns
    assert t_ns.tolist() == [0, 10**9, 2 * 10**9]


@pytest.mark.parametrize("mark", ["covariance0", "covariance[0]", "covariance.0"])
def test_rates_that_a_covariance_marks_as_absent_are_not_used(tmp_path, mark):
    """As in the message that became the row: there is no gyroscope, whatever stands in it."""
    path = tmp_path / "imu.csv"
    names = ",".join(f"angular_velocity.{axis}" for axis in "xyz")
    path.write_text(
        f"header.stamp.sec,header.stamp.nanosec,{names},angular_velocity_{mark}\n"
        "1,0,1,2,3,0.5\n2,0,0,0,0,-1\n"
    )
    rates = read_rates(path)
    assert rates.t_ns.tolist() == [10**9, 2 * 10**9]
    np.testing.assert_array_equal(rates.rate, [[1, 2, 3], 3 * [np.nan]])


def test_differences_of_time_are_not_the_time():
    """Each is the length of an interval."""
    with pytest.raises(UndeclaredError, match=r"whether 'timediff \(ms\)' is the time is not"):
        chosen("timediff (ms),gx_dps,gy_dps,gz_dps")


def test_rates_about_axes_that_nobody_knows_are_named_by_the_user():
    """OpenRocket's pitch and yaw rates are about axes that follow the airflow, not the body."""
    header = "Time (s),Roll rate (\u00b0/s),Pitch rate (\u00b0/s),Yaw rate (\u00b0/s)"
    with pytest.raises(UndeclaredError) as caught:
        chosen(header)
    assert str(caught.value) == (
        "log.csv: about which axes 'Roll rate (\u00b0/s)', 'Pitch rate (\u00b0/s)', "
        "'Yaw rate (\u00b0/s)' turn (those of the body, or others, as in OpenRocket) is not "
        "declared; say it with rate_cols='X,Y,Z' if they are those of the body"
    )
    named = chosen(header, rate_cols=("Roll rate", "Pitch rate", "Yaw rate"))
    assert matched(named) == ((1, 2, 3), "deg/s", (0,), "s", "")
