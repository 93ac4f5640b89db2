"""Names of columns in text tables that repeat, are numbers, or count; and how to name them."""

import numpy as np
import pytest
from make.commands import refused, run
from make.table_rates import told

from quatprop import read_rates

COUNT = 300
RATE = np.round(np.sin(np.arange(COUNT)[:, None] / 30 + np.arange(3)), 6)
BACK = [2, 0, 1]
"""Columns of x, y and z in the order z, x, y."""


def table(path, header, rows, encoding="utf-8"):
    """Write a header and rows of cells; return the path."""
    lines = [header, *(",".join(map(str, row)) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding)
    return path


def rows_of_gopro(rate):
    """Return the rows of a stream of GoPro's telemetry, with a time in ms."""
    return [[10 * k, f"2024-05-01T10:00:{k // 100:02}.{k % 100:02}0Z", *rate[k], 41.5]
            for k in range(COUNT)]  # fmt: skip


def test_a_header_with_numbers_of_components_is_one(tmp_path):
    """It was left out, so that columns had numbers; its names work as they are printed."""
    header = "cts,date,Gyroscope [rad/s],1,2,temperature"
    path = table(tmp_path / "log.csv", header, rows_of_gopro(RATE))
    said = refused("propagate", path, "-o", "-")
    assert "its columns are 'cts', 'date', 'Gyroscope [rad/s]', '1', '2', 'temperature'" in said
    options = {"time_col": "cts", "time_unit": "ms", "rate_unit": "rad/s"}
    found = read_rates(path, rate_cols="Gyroscope [rad/s],1,2", **options)
    np.testing.assert_array_equal(found.rate, RATE)


def test_the_order_of_axes_in_a_name_is_that_of_the_columns(tmp_path):
    """As of newer telemetry: the columns are z, x and y."""
    header = '"cts","date","Gyroscope (z,x,y) [rad/s]","1","2","temperature [C]"'
    path = table(tmp_path / "log.csv", header, rows_of_gopro(RATE[:, BACK]))
    np.testing.assert_array_equal(read_rates(path).rate, RATE)


def test_names_that_repeat_are_shown_with_their_numbers(tmp_path):
    """They could not be told apart in what was printed."""
    rows = [[k / 100, *RATE[k], *-RATE[k]] for k in range(COUNT)]
    path = table(tmp_path / "log.csv", "t,gx,gy,gz,gx,gy,gz", rows)
    said = refused("propagate", path, "-o", "-")
    assert "its columns are '0: t', '1: gx', '2: gy', '3: gz', '4: gx', '5: gy', '6: gz'" in said
    units = {"rate_unit": "rad/s", "time_unit": "s"}
    np.testing.assert_array_equal(read_rates(path, rate_cols="4,5,6", **units).rate, -RATE)
    same = table(tmp_path / "same.csv", "t,gyro,gyro,gyro", [row[:4] for row in rows])
    said = refused("propagate", same, "--rate-cols", "gyro,gyro,gyro", "-o", "-")
    assert said.endswith("if several have that name, give their numbers, from 0")
    np.testing.assert_array_equal(read_rates(same, rate_cols="1,2,3", **units).rate, RATE)


VICON = "Devices\n1000\n,,imu - Gyro,,\nFrame,Sub Frame,Gyro X,Gyro Y,Gyro Z\n,,deg/s,deg/s,deg/s"


@pytest.mark.parametrize("header", [VICON, "Frame,Sub Frame,gx (deg/s),gy (deg/s),gz (deg/s)"])
def test_samples_within_a_frame_are_no_sensors(tmp_path, header):
    """Their numbers were taken for labels of ten sensors."""
    rows = [[k // 10 + 1, k % 10, *RATE[k]] for k in range(COUNT)]
    path = table(tmp_path / "log.csv", header, rows)
    assert "or --sample-rate HZ for rows at a steady rate" in refused("propagate", path, "-o", "-")
    t_ns, _ = told(path, sample_rate=1000)
    assert t_ns == [k * 10**6 for k in range(COUNT)]
    said = refused("propagate", path, "--time-col", "Frame,Sub Frame", "-o", "-")
    assert said.endswith("no seconds and a fraction of them; count rows with --sample-rate HZ")


@pytest.mark.parametrize(("name", "words"), [("log.csv", ()), ("log.asc", ("--from", "csv"))])
def test_names_in_latin_1_are_read(tmp_path, name, words):
    """As catman writes them; what is printed for an unknown suffix works."""
    rates = ",".join(f"Drehrate {axis} [\u00b0/s]" for axis in "XYZ")
    header = f"Zeit [s],{rates},Gr\u00f6\u00dfe"
    rows = [[k / 100, *RATE[k], "gro\u00df"] for k in range(COUNT)]
    path = table(tmp_path / name, header, rows, "latin-1")
    if words:
        assert "if you know its kind, use --from" in refused("propagate", path, "-o", "-")
    said = run("propagate", path, *words, "-o", "-", code=0).stderr
    assert "deg/s, Zeit [s] clock" in said
