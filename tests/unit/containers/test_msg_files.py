"""Bags without message definitions: those in .msg files, beside the bag or named."""

import shutil
import sqlite3
import struct

import numpy as np
import pytest
from click.testing import CliRunner
from mcap.writer import Writer

import quatprop
from quatprop.cli.commands import cli
from quatprop.errors import SchemaError, UsageError
from quatprop.logs.open_log import open_log
from quatprop.logs.signals.rates import choose_rates
from quatprop.settings.selection import RateSelection

GYRO = "builtin_interfaces/Time stamp\nTriple[1] angular\nfloat64 temperature\n"
TRIPLE = "float64 x  # rad/s\nfloat64 y\nfloat64 z\n"
TABLES = """
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
INSERT INTO topics VALUES (1, '/gyro', 'my_msgs/msg/Gyro', 'cdr');
"""


def message(number):
    """Return a message in CDR."""
    values = struct.pack("<iI4d", 1, 10_000_000 * number, 0.1, 0.2, 0.3, 20.0)
    return b"\x00\x01\x00\x00" + values


def write_db3(path):
    """Write a database as Humble does, without definitions."""
    path.parent.mkdir(exist_ok=True)
    database = sqlite3.connect(path)
    database.executescript(TABLES)
    for number in range(50):
        row = number, 10**9 + number, message(number)
        database.execute("INSERT INTO messages VALUES (?, 1, ?, ?)", row)
    database.commit()
    database.close()
    return path


def write_mcap(path):
    """Write an MCAP file whose schema is empty."""
    path.parent.mkdir(exist_ok=True)
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "")
        schema = writer.register_schema("my_msgs/msg/Gyro", "", b"")
        channel = writer.register_channel("/gyro", "cdr", schema)
        for number in range(50):
            writer.add_message(channel, 10**9 + number, message(number), 10**9 + number)
        writer.finish()
    return path


LOGS = {
    "db3": lambda folder: write_db3(folder / "log.db3"),
    "mcap": lambda folder: write_mcap(folder / "log.mcap"),
    "db3 folder": lambda folder: write_db3(folder / "bag" / "bag_0.db3").parent,
    "mcap folder": lambda folder: write_mcap(folder / "bag" / "bag_0.mcap").parent,
}


@pytest.fixture(params=LOGS)
def log(request, tmp_path):
    """Give a log of each kind without definitions."""
    return LOGS[request.param](tmp_path)


def put(folder):
    """Write the definitions into a package."""
    (folder / "my_msgs" / "msg").mkdir(parents=True)
    (folder / "my_msgs" / "msg" / "Gyro.msg").write_text(GYRO)
    (folder / "my_msgs" / "msg" / "Triple.msg").write_text(TRIPLE)
    return folder / "my_msgs"


def definitions(log, msg_path=None):
    """Return the definitions of the channels of a log, and what is remarked."""
    with open_log(log, msg_path=msg_path) as opened:
        schemas = [channel.schema.decode() for channel in opened.channels()]
        return schemas, list(opened.remarks)


def test_a_missing_definition_is_said(log):
    """The error names the type and the way out."""
    with (
        open_log(log) as opened,
        pytest.raises(
            SchemaError,
            match=r"no definition of 'my_msgs/msg/Gyro' and it is not a standard type; "
            r"put its .msg files beside the log, or name them with msg_path$",
        ),
    ):
        choose_rates(opened, RateSelection(topic="/gyro", rate_field="angular"))


def test_files_beside_the_bag_are_used(log, tmp_path):
    """A package beside a bag is found by its name, and named."""
    package = put(tmp_path)
    (schema,), remarks = definitions(log)
    assert schema == f"{GYRO}\n{'=' * 80}\nMSG: my_msgs/msg/Triple\n{TRIPLE}"
    assert remarks == [
        f"'my_msgs/msg/Gyro' is defined by {package / 'msg' / 'Gyro.msg'}",
        f"'my_msgs/msg/Triple' is defined by {package / 'msg' / 'Triple.msg'}",
    ]


@pytest.mark.parametrize("which", [".", "my_msgs", "my_msgs/msg"])
def test_a_package_that_is_named_is_used(log, tmp_path, which):
    """It may be the package, its folder of messages, or what packages lie in."""
    elsewhere = tmp_path / "elsewhere" / "src"
    put(elsewhere)
    assert definitions(log)[0] == [""]
    assert definitions(log, elsewhere.parent if which == "." else elsewhere / which)[0] != [""]


def test_one_file_that_is_named_is_used(log, tmp_path):
    """What it does not define is looked for nowhere else."""
    file = put(tmp_path / "elsewhere") / "msg" / "Gyro.msg"
    assert definitions(log, file)[0] == [GYRO]
    shutil.rmtree(tmp_path / "elsewhere")
    with pytest.raises(UsageError, match=r"Gyro.msg: no such file or folder; check msg_path$"):
        definitions(log, file)


def test_messages_are_decoded_by_such_a_definition(tmp_path):
    """Samples come out as they went in."""
    log = write_db3(tmp_path / "log.db3")
    put(tmp_path)
    (tmp_path / "my_msgs" / "msg" / "Gyro.msg").write_text(GYRO.replace("[1]", ""))
    selection = RateSelection(topic="/gyro", rate_field="angular", rate_unit="rad/s",
                              time_field="stamp")  # fmt: skip
    with open_log(log) as opened:
        series = list(choose_rates(opened, selection).batches())
    rate = np.concatenate([batch.rate for batch in series])
    assert rate.tolist() == [[0.1, 0.2, 0.3]] * 50


def test_definitions_are_named_to_every_command(log, tmp_path):
    """The option arrives where the log is opened; without it, it is the way out."""
    package = put(tmp_path / "elsewhere")
    run = CliRunner().invoke
    rates = [str(log), "-t", "/gyro", "--rate-field", "angular", "--rate-unit", "rad/s"]
    refused = run(cli, ["propagate", *rates, "-o", "-"])
    assert (refused.exit_code, refused.stderr.rstrip()[-44:]) == (
        2,
        "beside the log, or name them with --msg-path",
    )
    given = ["--msg-path", str(package)]
    done = run(cli, ["propagate", *rates, "-o", str(tmp_path / "out.csv"), *given])
    assert done.exit_code == 0, done.stderr
    assert "'my_msgs/msg/Gyro' is defined by" in done.stderr
    info = run(cli, ["info", *rates, *given])
    assert "50" in info.stdout
    with pytest.warns(quatprop.RemarkWarning, match="is defined by"):
        series = quatprop.propagate(
            log, topic="/gyro", rate_field="angular", rate_unit="rad/s", msg_path=package
        )
    assert len(series) == 50
    expected = {str(package / "msg" / f"{name}.msg") for name in ("Gyro", "Triple")}
    assert series.report.files.keys() == expected
    assert {one.bytes for one in series.report.files.values()} == {len(GYRO), len(TRIPLE)}


def test_outputs_and_references_depend_on_definitions(log, tmp_path, monkeypatch):
    """Those in a package below the folder that is named: changed, they give other rates."""
    monkeypatch.setenv("GITHUB_ACTIONS", "")
    file = put(tmp_path / "src" / "elsewhere") / "msg" / "Triple.msg"
    options = ["-t", "/gyro", "--rate-field", "angular", "--rate-unit", "rad/s"]
    batch = ["batch", str(log), "-o", str(tmp_path / "out"), "-j", "1", "--skip-existing", *options]
    (tmp_path / "suite.toml").write_text(
        f'[case.a]\nlog = "{log}"\nreference = "a.parquet"\ntopic = "/gyro"\n'
        'rate-field = "angular"\nrate-unit = "rad/s"\nmsg-path = "src"\n'
    )
    run, check = CliRunner().invoke, ["check", str(tmp_path / "suite.toml")]
    assert run(cli, [*check, "--update"]).exit_code == 0
    for text, up_to_date in ((TRIPLE, False), (TRIPLE, True), (f"{TRIPLE}#\n", False)):
        file.write_text(text) if file.read_text() != text else None
        done = run(cli, [*batch, "--msg-path", str(tmp_path / "src")])
        assert ("up to date" in done.stderr) == up_to_date, done.stderr
    done = run(cli, check)
    assert done.exit_code == 2
    assert f"{file}: its content changed since the reference was made" in done.stdout
