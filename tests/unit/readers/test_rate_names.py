"""Proofs from column names: words of frames, roles and statistics, widths, orders."""

import itertools
import json
import re

import h5py
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
from make.commands import refused, run
from make.table_rates import refusal, table_rates

from quatprop import propagate, read_attitudes
from quatprop.base.errors import LogError, NoRatesError, UndeclaredError, UsageError
from quatprop.kinematics.quaternion import geodesic_angle

RATES = np.random.default_rng(1).uniform(-1, 1, (20, 3)).round(4)
T_S = np.arange(20) / 100

# --- words

QUANTITIES = "gyro_{} w{} angular_velocity_{} {}Rate"
FRAMES = "world ned enu nav inertial eci ecef earth odom local n"
ROLES = "cmd commanded ref sp setpoint desired target err error innov residual joint earth_rate bg"
STATISTICS = "abs uncertainty std sigma var mean rms max limit offset"
UNKNOWN = "model truth delta pid xyzzy acc dot i"
NO_RATES = f"{FRAMES} {ROLES} {STATISTICS} {UNKNOWN}".split()
SENSORS = "imu imu0 left_wrist raw calibrated body sensor_1 icm20948 upperarm UserBody"
PLACES = ("{word}_{name}", "{name}_{word}", "{word}/{name}")


def table(name, word, place, unit="rad/s"):
    """Return a table whose rates have a word in their names."""
    columns = [place.format(word=word, name=name.format(axis)) for axis in "xyz"]
    rows = (f"{t},{','.join(map(str, w))}\n" for t, w in zip(T_S, RATES.tolist(), strict=True))
    return f"t_s,{','.join(f'{column} ({unit})' for column in columns)}\n{''.join(rows)}"


@pytest.mark.parametrize("place", PLACES)
def test_a_word_that_no_sensor_has_is_not_believed(place):
    """Commands, errors and rates in axes of the world were integrated as body rates."""
    read = []
    for name, word in itertools.product(QUANTITIES.split(), NO_RATES):
        for spelled in (word, word.upper()):
            try:
                table_rates(table(name, spelled, place))
            except (NoRatesError, UndeclaredError):
                continue
            read.append((name, spelled))
    assert read == []


@pytest.mark.parametrize("end", [".1", "_1", "_duplicated_0", "_copy", ".2"])
@pytest.mark.parametrize("name", ["gyro_{}", "w{}_rad_s", "G{} (deg/s)"])
def test_rates_of_a_second_sensor_are_said(name, end):
    """The first were used without a word about the others."""
    names = [name.format(axis) for axis in "xyz"]
    head = ",".join(["t_s", *names, *(f"{each}{end}" for each in names)])
    text = f"{head}\n" + "".join(f"{t},1,2,3,4,5,6\n" for t in T_S)
    unit = {} if "s" in name else {"rate_unit": "rad/s"}
    (remark,) = table_rates(text, **unit).remarks
    assert remark.startswith(f"'{names[0]}{end}', '{names[1]}{end}', '{names[2]}{end}' are not ")
    chosen = re.search("rate_cols='(.*)'$", remark)[1]
    found = table_rates(text, rate_cols=chosen.split(","), rate_unit="rad/s")
    assert (found.rate[0].tolist(), found.remarks) == ([4, 5, 6], [])
    alone = text.replace(f",{names[2]}{end}", f",other{end}")
    assert table_rates(alone, **unit).remarks == []


WORLD = "omega_w_{} omega_W_{} ang_vel_w.{} angular_velocity_w_{} gyro_{}_w gyr_{}_W imu/omega_w_{}"
NO_WORLD = "w{} w_{} w.{} imu_w_{} gyro.w.{} body_w{} imu_w.{} gyro_w{}"


def test_a_w_next_to_the_axis_is_the_world_only_of_another_word_for_a_rate():
    """In Isaac Lab, ang_vel_w is the world's and ang_vel_b the body's; w alone is the rate."""
    for name in WORLD.split():
        with pytest.raises(UndeclaredError, match="axes of the body or of 'w' is not declared"):
            table_rates(table(name, "", "{name}"))
        assert len(table_rates(table(name, "", "{name}"), rates="inertial").rate) == len(RATES)
    for name in NO_WORLD.split():
        table_rates(table(name, "", "{name}"))


@pytest.mark.parametrize("place", PLACES)
def test_words_for_sensors_and_their_places_are_known(place):
    """They tell which body turns, and how it was measured."""
    for name, word in itertools.product(
        ("gyro_{}", "omega_{}", "AngularVelocity_{}"), SENSORS.split()
    ):
        np.testing.assert_array_equal(table_rates(table(name, word, place)).rate, RATES)


@pytest.mark.parametrize("word", UNKNOWN.split())
def test_columns_with_an_unknown_word_are_read_when_they_are_named(word):
    """The way out that the refusal states is the name of the columns."""
    text = table("gyro_{}", word, "{word}_{name}")
    sentence = refusal(text, UndeclaredError)
    assert f"are the rates of the body ('{word}' does not tell)" in sentence
    named = re.search(r"rate_cols='(.*?)'", sentence)[1].split(",")
    np.testing.assert_array_equal(table_rates(text, rate_cols=named).rate, RATES)


def test_an_unknown_word_and_a_unit_are_asked_for_together():
    """One refusal names all options that are missing."""
    text = "t_s,xyzzy_gyro_x,xyzzy_gyro_y,xyzzy_gyro_z\n0,1,2,3\n"
    sentence = refusal(text, UndeclaredError)
    assert (
        "rate_cols='xyzzy_gyro_x,xyzzy_gyro_y,xyzzy_gyro_z' if they are and rate_unit" in sentence
    )


def test_rates_of_the_body_come_before_those_in_other_axes():
    """Both are in many logs of simulators."""
    both = "t_s,gyro_world_x (rad/s),gyro_world_y (rad/s),gyro_world_z (rad/s)"
    both += ",gyro_x (rad/s),gyro_y (rad/s),gyro_z (rad/s)\n0,1,2,3,4,5,6\n"
    assert table_rates(both).rate.tolist() == [[4, 5, 6]]
    assert table_rates(both, rates="inertial").rate.tolist() == [[1, 2, 3]]


def test_rates_in_the_axes_of_the_world_are_read_as_inertial_ones(tmp_path, monkeypatch):
    """The refusal names the option, and with it the attitudes are right."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "log.csv").write_text(table("angular_velocity_{}", "world", "{name}_{word}"))
    sentence = refused("propagate", "log.csv", "-o", "o.csv")
    assert "about axes of the body or of 'world' is not declared" in sentence
    (option,) = re.findall("--rates inertial", sentence)
    run("propagate", "log.csv", "-o", "o.csv", *option.split(), code=0)
    named = {"rate_cols": "1,2,3", "rates": "inertial"}
    right = propagate("log.csv", **named)
    assert geodesic_angle(read_attitudes("o.csv").wxyz, right.wxyz).max() == 0
    body = propagate("log.csv", rate_cols="1,2,3", rates="body")
    assert body.report.remarks == ()
    assert geodesic_angle(body.wxyz, right.wxyz)[-1] > 1e-4  # rates that change their axis


def test_inertial_rates_are_read_back_as_they_were_written(tmp_path, monkeypatch):
    """The columns of ``convert --as inertial-rates`` had to be named."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "log.csv").write_text(table("gyro_{}", "imu", "{word}_{name}"))
    run("propagate", "log.csv", "-o", "a.csv", code=0)
    for suffix in ("csv", "parquet", "jsonl", "npz"):
        run("convert", "a.csv", f"r.{suffix}", "--as", "inertial-rates", code=0)
        assert "--rates inertial" in refused("propagate", f"r.{suffix}", "-o", "b.csv")
        run("propagate", f"r.{suffix}", "-o", f"{suffix}.csv", "--rates", "inertial", code=0)
        first, second = read_attitudes("a.csv").wxyz, read_attitudes(f"{suffix}.csv").wxyz
        assert geodesic_angle(first, second).max() < 1e-12  # rates are written in full


# --- widths


def matrix(path, name, values):
    """Write times and a matrix of numbers as a table of a kind."""
    if path.suffix == ".npz":
        np.savez(path, **{name: values, "t_s": T_S})
    elif path.suffix == ".h5":
        with h5py.File(path, "w") as file:
            file[name], file["t_s"] = values, T_S
    elif path.suffix == ".mat":
        scipy.io.savemat(path, {name: values, "t_s": T_S[:, None]})
    elif path.suffix == ".jsonl":
        lists = zip(T_S.tolist(), values.tolist(), strict=True)
        path.write_text("".join(json.dumps({"t_s": t, name: row}) + "\n" for t, row in lists))
    elif path.suffix == ".parquet":
        pq.write_table(pa.table({"t_s": T_S, name: pa.array(values.tolist())}), path)
    else:
        names = [f"{name}[{k}]" for k in range(values.shape[1])]
        pd.DataFrame(values, columns=names).assign(t_s=T_S).to_csv(path, index=False)
    return path


@pytest.mark.parametrize("kind", ["npz", "h5", "mat", "jsonl", "parquet", "csv"])
def test_only_three_components_are_rates(tmp_path, kind):
    """The first three of a wider matrix were integrated: a time, or accelerations."""
    for name, width in itertools.product(
        ("gyro", "omega", "imu_angular_velocity"), (2, 3, 4, 6, 9)
    ):
        values = np.hstack((np.zeros((20, 6)), RATES))[:, 9 - width :]
        path = matrix(tmp_path / f"{name}{width}.{kind}", name, values)
        given = {"rate_unit": "rad/s", "time_col": "t_s", "time_unit": "s"}
        if width != 3:
            sentence = refusal(path, LogError, **given)
            assert width == 2 or "are the rates about x, y and z is not declared" in sentence
            if width == 2:
                continue
            given["rate_cols"] = [f"{name}[{k}]" for k in range(width - 3, width)]
        np.testing.assert_array_equal(table_rates(path, **given).rate, RATES)


@pytest.mark.parametrize("kind", ["jsonl", "parquet"])
def test_a_list_that_becomes_longer_has_no_rates_there(tmp_path, kind):
    """Its first three numbers were read on as rates: a time, and two of them."""
    lists = [[0.0, *rate] if k > 12 else rate for k, rate in enumerate(RATES.tolist())]
    path = tmp_path / f"log.{kind}"
    if kind == "jsonl":
        rows = zip(T_S.tolist(), lists, strict=True)
        path.write_text("".join(json.dumps({"t_s": t, "gyro": row}) + "\n" for t, row in rows))
    else:
        pq.write_table(pa.table({"t_s": T_S, "gyro": pa.array(lists)}), path)
    found = table_rates(path, rate_unit="rad/s", time_col="t_s", time_unit="s")
    np.testing.assert_array_equal(found.rate[:13], RATES[:13])
    assert np.isnan(found.rate[13:]).all()


def test_a_list_of_five_numbers_is_no_quaternion(tmp_path):
    """Nothing tells which of them are its components."""
    path = matrix(tmp_path / "log.npz", "quat", np.ones((20, 5)))
    with pytest.raises(LogError, match="no attitudes found"):
        read_attitudes(path, from_layout="scalar-first", time_unit="s")


# --- orders


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
@pytest.mark.parametrize(
    "name", ["{} rate (deg/s)", "{}Rate (deg/s)", "{} (deg/s)", "gyro_{} (deg/s)", "rate{} (dps)"]
)
def test_rates_of_roll_pitch_and_yaw_are_asked_for_in_the_order_of_the_axes(order, name):
    """They were listed in the order of the file, and taken as x, y and z."""
    names = [name.format(("Roll", "Pitch", "Yaw")[k]) for k in order]
    text = f"Time (s),{','.join(names)}\n0,{','.join(str(k + 1) for k in order)}\n"
    sentence = refusal(text, UndeclaredError)
    places = [sentence.index(name.format(axis)) for axis in ("Roll", "Pitch", "Yaw")]
    assert places == sorted(places)
    named = re.search("rate_cols='(.*?)'", sentence)[1].split(",")
    found = table_rates(text, rate_cols=named)
    np.testing.assert_allclose(np.degrees(found.rate), [[1, 2, 3]])
    assert found.remarks == []


@pytest.mark.parametrize("names", ["{}", "g{} (rad/s)", "{}_gyro", "Gyro {} (dps)", "gyro.{}"])
@pytest.mark.parametrize("axes", ["xyz", "XYZ", "pqr", "012"])
def test_names_of_axes_in_another_order_are_remarked_on(names, axes):
    """Whoever names the columns may mean it; whoever pastes them does not."""
    columns = [names.format(axis) for axis in axes]
    if axes == "012":
        columns = [f"gyro[{axis}]" for axis in axes]
    text = f"t_s,{','.join(columns)}\n0,1,2,3\n"
    given = {"rate_unit": "rad/s"}
    assert "by their names" not in str(table_rates(text, rate_cols=columns, **given).remarks)
    for order in list(itertools.permutations(range(3)))[1:]:
        found = table_rates(text, rate_cols=[columns[k] for k in order], **given)
        assert found.rate.tolist() == [[k + 1 for k in order]]
        assert f"which by their names are {', '.join('xyz'[k] for k in order)}" in str(
            found.remarks
        )


def test_a_column_named_twice_is_still_refused():
    """An order that is not one has no remark."""
    text = "t_s,gyro_x,gyro_y,gyro_z\n0,1,2,3\n"
    assert "names a column twice" in refusal(text, UsageError, rate_cols=["gyro_x"] * 3)


# --- columns that the user has named

NAMED = {"rate_cols": ("1", "2", "3")}
MEANINGS = {
    "cmd_{pqr} {xyz}_sp target_w{xyz} gyro_{xyz}_des wheel_w{xyz} err_gyro_{xyz} rms_w{xyz}": (
        "by their names they are not measured by a gyroscope of the body ("
    ),
    "delta_angle_{xyz} dTheta_{xyz} dtheta_{xyz} d_theta.{xyz} delta_phi_{xyz} gyro_incr_{xyz}": (
        "by their names they are increments of angles, to be divided by their intervals"
    ),
    "phi_dot,theta_dot,psi_dot rollDot,pitchDot,yawDot euler_rate_{xyz} phi,theta,psi": (
        "by their names they are rates of Euler angles, which are not about axes of the body"
    ),
    "omega_n,omega_e,omega_d w_{xyz}_enu n_gyro_{xyz}": "if they are about those of '",
    "gyro_{xyz} raw_{pqr} frob_{xyz} gyro_uncal_{xyz} imu_n2_gyro_{xyz} vel_ang_{xyz} {pqr}": "",
}
"""Names of rates, and the remarks on them."""


def spelled_out(names):
    """Return three names."""
    if "," in names:
        return names.split(",")
    letters = "pqr" if "{pqr}" in names else "xyz"
    return [names.replace(f"{{{letters}}}", letter) for letter in letters]


def named(columns, **options):
    """Read rates from columns that the user has named."""
    rows = (f"{t},{','.join(map(str, w))}\n" for t, w in zip(T_S, RATES.tolist(), strict=True))
    return table_rates(f"t_s,{','.join(columns)}\n{''.join(rows)}", **NAMED, **options)


@pytest.mark.parametrize("names", MEANINGS)
def test_what_names_say_is_said_again_of_columns_that_are_named(names):
    """Commands, increments and Euler rates were read as rates, without a word, once named."""
    for one in names.split():
        said = named(spelled_out(one), rate_unit="rad/s").remarks
        assert len(said) == bool(MEANINGS[names]), (one, said)
        assert not said or MEANINGS[names] in said[0], (one, said)


UNIT_WORDS = {"rad_s": 1.0, "dps": np.pi / 180, "deg_s": np.pi / 180, "rpm": np.pi / 30}


@pytest.mark.parametrize("unit", UNIT_WORDS)
@pytest.mark.parametrize("name", ["gyro_uncal_{}", "frob_{}", "{}_cooked", "p_mystery_{}"])
def test_a_unit_at_the_end_of_any_name_is_read_once_columns_are_named(name, unit):
    """It was asked for, and any answer was taken."""
    columns = [f"{name.format(axis)}_{unit}" for axis in "xyz"]
    assert np.allclose(named(columns).rate, RATES * UNIT_WORDS[unit], rtol=1e-12)
    other = "rad/s" if unit != "rad_s" else "deg/s"
    assert any("read in" in remark for remark in named(columns, rate_unit=other).remarks)


@pytest.mark.parametrize("unit", ["rev/s", "deg", "Grad/s", "counts", "LSB", "mV", "rad"])
def test_a_unit_that_contradicts_a_foreign_one_is_remarked_on(unit):
    """It does not convert the numbers, as a user may think."""
    columns = [f"gyro_{axis} [{unit}]" for axis in "xyz"]
    (said,) = named(columns, rate_unit="deg/s").remarks
    assert said.endswith("the numbers are read in deg/s, as requested, and not converted")


@pytest.mark.parametrize("stem", ["angular_velocity", "twist.angular", "AngularVelocity"])
def test_the_rates_that_are_read_are_not_said_to_be_ignored(stem):
    """A name that is an estimate next to others may be the only one."""
    columns = [f"{stem}.{axis}" for axis in "xyz"]
    assert named(columns, rate_unit="rad/s").remarks == []
