"""What is printed of a file beside the log works: options for the log do not apply to it."""

import numpy as np
import pandas as pd
import pytest
from make.commands import refused, run

COUNT = 200
T_S = np.arange(COUNT) / 100
RATES = [f"gyro_{axis} (rad/s)" for axis in "xyz"]
BIASES = [f"gyro_bias_{axis} (rad/s)" for axis in "xyz"]
UNDECLARED = (
    "not declared, and options for the rates do not apply to it; state it in the names of its "
    "columns, such as time_s or gyro_bias_x (rad/s)"
)


@pytest.mark.parametrize(
    ("option", "names", "values"),
    [
        ("--bias", BIASES, [0.1, 0.2, 0.3]),
        ("--at", ["a", "b", "c"], [1.0, 2.0, 3.0]),
    ],
)
def test_the_time_of_a_file_beside_the_log_is_stated_in_its_header(tmp_path, option, names, values):
    """An option was named that is of the log, and changes nothing."""
    log, beside = tmp_path / "log.csv", tmp_path / "beside.csv"
    rates = dict(zip(RATES, (0.1, 0.2, 0.3), strict=True))
    pd.DataFrame({"time": T_S, **rates}).to_csv(log, index=False)
    rows = pd.DataFrame({"time": T_S[::10], **dict(zip(names, values, strict=True))})
    rows.to_csv(beside, index=False)
    words = "propagate", log, "--time-unit", "s", option, beside, "-o", tmp_path / "o.csv"
    said = refused(*words)
    assert said.endswith(UNDECLARED)
    assert f"{beside}: the unit of the time 'time' is" in said
    rows.rename(columns={"time": "time_s"}).to_csv(beside, index=False)
    run(*words, code=0)
    found = pd.read_csv(tmp_path / "o.csv")
    expected = rows["time"] if option == "--at" else T_S
    np.testing.assert_array_equal(found["t_ns"], np.round(expected * 1e9).astype(int))
    last = found.iloc[-1].to_numpy()[1:5]
    if option == "--bias":
        np.testing.assert_allclose(last, [1, 0, 0, 0], atol=1e-12)
