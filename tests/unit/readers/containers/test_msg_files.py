"""Bags without message definitions: those in .msg files, next to the bag or named."""

import shutil
import sqlite3
import struct
from contextlib import closing

import pytest
from make.commands import refused, run
from make.mcap import Topic, write_topics
from make.reading import rates

import quatprop
from quatprop.base.errors import SchemaError, UsageError
from quatprop.readers.containers.message_log import MsgFiles
from quatprop.readers.open_log import open_log

GYRO = "builtin_interfaces/Time stamp\nTriple[1] angular\nfloat64 temperature\n"
TRIPLE = "float64 x  # rad/s\nfloat64 y\nfloat64 z\n"
MESSAGES = [
    b"\x00\x01\x00\x00" + struct.pack("<iI4d", 1, 10_000_000 * number, 0.1, 0.2, 0.3, 20.0)
    for number in range(50)
]
RATES = {"topic": "/gyro", "rate_field": "angular", "rate_unit": "rad/s"}
OPTIONS = ("-t", "/gyro", "--rate-field", "angular", "--rate-unit", "rad/s")


TABLES = """
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
INSERT INTO topics VALUES (1, '/gyro', 'my_msgs/msg/Gyro', 'cdr');
"""


def write_db3(path):
    """Write a database as Humble does, without definitions."""
    path.parent.mkdir(exist_ok=True)
    with closing(sqlite3.connect(path)) as database, database:
        database.executescript(TABLES)
        for number, message in enumerate(MESSAGES):
            row = number, 10**9 + number, message
            database.execute("INSERT INTO messages VALUES (?, 1, ?, ?)", row)
    return path


def write_mcap(path):
    """Write an MCAP file whose schema is empty."""
    path.parent.mkdir(exist_ok=True)
    topic = Topic("my_msgs/msg/Gyro", MESSAGES, b"", "", "cdr")
    return write_topics(path, {"/gyro": topic}, profile="ros2")


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


def put(folder, gyro=GYRO):
    """Write the definitions into a package."""
    messages = folder / "my_msgs" / "msg"
    messages.mkdir(parents=True)
    (messages / "Gyro.msg").write_text(gyro)
    (messages / "Triple.msg").write_text(TRIPLE)
    return folder / "my_msgs"


def definitions(log, msg_path=None):
    """Return the definitions of the channels of a log, and what is remarked."""
    with open_log(log, msg_path=msg_path) as opened:
        schemas = [channel.schema.decode() for channel in opened.channels()]
        return schemas, list(opened.remarks)


def test_files_next_to_the_bag_are_used(log, tmp_path):
    """A package is found by its name, and named; without it, the error names the way out."""
    reason = (
        r"no definition of 'my_msgs/msg/Gyro' and it is not a standard type; "
        r"put its .msg files next to the log, or name them with msg_path$"
    )
    with pytest.raises(SchemaError, match=reason):
        rates(log, **RATES)
    package = put(tmp_path)
    (schema,), remarks = definitions(log)
    assert schema == f"{GYRO}\n{'=' * 80}\nMSG: my_msgs/msg/Triple\n{TRIPLE}"
    assert remarks == [
        f"'my_msgs/msg/{name}' is defined by {package / 'msg' / name}.msg"
        for name in ("Gyro", "Triple")
    ]


@pytest.mark.parametrize("which", [".", "my_msgs", "my_msgs/msg"])
def test_a_package_that_is_named_is_used(log, tmp_path, which):
    """It may be the package, its folder of messages, or what packages lie in."""
    elsewhere = tmp_path / "elsewhere" / "src"
    put(elsewhere)
    assert definitions(log)[0] == [""]
    assert definitions(log, elsewhere.parent if which == "." else elsewhere / which)[0] != [""]


def test_one_file_that_is_named_is_used(log, tmp_path):
    """A missing definition is searched for nowhere else; a file over 64 KiB defines nothing."""
    file = put(tmp_path / "elsewhere") / "msg" / "Gyro.msg"
    assert definitions(log, file)[0] == [GYRO]
    for size, is_read in ((1 << 16, True), ((1 << 16) + 1, False)):
        file.write_text(GYRO.ljust(size, "#"))
        assert definitions(log, file)[0] == [file.read_text() if is_read else ""]
    shutil.rmtree(tmp_path / "elsewhere")
    with pytest.raises(UsageError, match=r"Gyro.msg: no such file or folder; check msg_path$"):
        definitions(log, file)


@pytest.mark.parametrize("name", ["../my_msgs/msg/Gyro", "bag/msg/../../my_msgs/msg/Gyro",
                                  f"my_msgs/msg/{'G' * 300}"])  # fmt: skip
def test_a_type_name_leads_to_no_other_folder(tmp_path, name):
    """Nor does one that is longer than the name of a file can be."""
    put(tmp_path)
    (tmp_path / "bag" / "msg").mkdir(parents=True)
    assert MsgFiles([tmp_path / "bag"]).definition(name) == b""


def test_messages_are_decoded_by_such_a_definition(tmp_path):
    """Samples come out as they went in."""
    put(tmp_path, GYRO.replace("[1]", ""))
    _, series, _ = rates(write_db3(tmp_path / "log.db3"), time_field="stamp", **RATES)
    assert series.rate.tolist() == [[0.1, 0.2, 0.3]] * 50


def test_definitions_are_named_to_every_command(log, tmp_path):
    """The option arrives where the log is opened; without it, it is the way out."""
    package, out = put(tmp_path / "elsewhere"), tmp_path / "out.csv"
    sentence = refused("propagate", log, *OPTIONS, "-o", "-")
    assert sentence.endswith("next to the log, or name them with --msg-path")
    done = run("propagate", log, *OPTIONS, "-o", out, "--msg-path", package, code=0)
    assert "'my_msgs/msg/Gyro' is defined by" in done.stderr
    assert "50" in run("info", log, *OPTIONS, "--msg-path", package).stdout
    with pytest.warns(quatprop.RemarkWarning, match="is defined by"):
        series = quatprop.propagate(log, msg_path=package, **RATES)
    assert len(series) == 50
    files = series.report.files
    assert files.keys() == {str(package / "msg" / f"{name}.msg") for name in ("Gyro", "Triple")}
    assert {one.bytes for one in files.values()} == {len(GYRO), len(TRIPLE)}


def test_outputs_and_references_depend_on_definitions(tmp_path):
    """Those in a package below the folder that is named: changed, they give other rates."""
    log, source = write_db3(tmp_path / "log.db3"), tmp_path / "src"
    file = put(source / "elsewhere") / "msg" / "Triple.msg"
    batch = ("batch", log, "-o", tmp_path / "out", "-j", "1", "--skip-existing", *OPTIONS)
    suite = tmp_path / "suite.toml"
    suite.write_text(
        f'[case.a]\nlog = "{log}"\nreference = "a.parquet"\ntopic = "/gyro"\n'
        'rate-field = "angular"\nrate-unit = "rad/s"\nmsg-path = "src"\n'
    )
    run("check", suite, "--update", code=0)
    for text, up_to_date in ((TRIPLE, False), (TRIPLE, True), (f"{TRIPLE}#\n", False)):
        file.write_text(text) if file.read_text() != text else None
        done = run(*batch, "--msg-path", source)
        assert ("up to date" in done.stderr) == up_to_date, done.stderr
    done = run("check", suite, code=2)
    assert f"{file}: its content changed since the reference file was made" in done.stdout
