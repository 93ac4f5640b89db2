"""The documents are true: commands, listings, suites, links."""

import json
import re
import shlex
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from make import ulog
from make.commands import run
from make.documents import GUIDES, ROOT, Document
from make.places import SHARED_LOGS
from make.reading import found_in, mark, stamps
from make.reference import python_reference, reference

import quatprop
from quatprop import propagate, write
from quatprop.base import __version__
from quatprop.cli.commands import GROUPS
from quatprop.readers import vocabulary
from quatprop.readers.messages.blocks import Channel
from quatprop.readers.vocabulary import TYPES
from quatprop.settings.parsers import keywords_of
from quatprop.writers.formats import WRITERS

README = ROOT / "README.md"
DOCUMENTS = [README, *sorted(GUIDES.glob("*.md"))]


@pytest.fixture
def ran(tmp_path, monkeypatch):
    """Return a function that runs a document and compares what is shown with what is printed."""
    monkeypatch.setenv("COLUMNS", "200")

    def ran(path):
        document = Document(path, tmp_path, SHARED_LOGS if SHARED_LOGS.is_dir() else None)
        assert document.run() == document.text
        return document

    return ran


def test_the_readme_teaches_what_is_true(ran):
    """Its commands and its listing run, and its picture shows what the commands print."""
    document = ran(README)
    samples, passed = document.printed.splitlines()
    assert samples.startswith("1000 [-9.99759")
    assert passed.startswith("True 7.8")
    (shown,) = re.findall(r"!\[.*?\]\((.*?)\)", document.text)
    assert (ROOT / shown).read_text() == document.terminal()


def test_each_reason_to_trust_it_has_a_number_that_its_link_shows():
    """Numbers of the README stand in the document or the test that they lead to, too."""
    reasons = README.read_text().split("**Why trust it?**")[1].split("![")[0]
    for line in reasons.strip().splitlines():
        ((path,),) = [re.findall(r"\]\(([^)#]*)", line)]
        (*_, number) = re.findall(r"\*\*([\d.e-]+)", line)
        assert number in (ROOT / path).read_text(), line
    expected = SHARED_LOGS / "expected.json"
    if expected.is_file():
        assert f"**{len(json.loads(expected.read_text()))}** real recordings" in reasons


def test_the_commands_for_what_a_reader_has_run(tmp_path, monkeypatch):
    """Each row of the table, on logs as it speaks of, in order."""
    monkeypatch.chdir(tmp_path)
    for log, motion, truth in (
        ("drive.mcap", "rest", "truth.csv"),
        ("leg.bag", "coning", "thigh.csv"),
        ("arm.bag", "tumbling", "shank.csv"),
        ("recordings/a.csv", "spin", "none"),
    ):
        Path(log).parent.mkdir(exist_ok=True)
        run("simulate", log, "--motion", motion, "--truth", truth, "--noise", "1e-4", "-q", code=0)
    rows = "".join(f"{number / 100},1,2,3\n" for number in range(100))
    Path("log.csv").write_text("t,gx,gy,gz\n" + rows)
    samples = [
        ulog.data("sensor_combined", 1, timestamp=4000 * k, gyro_integral_dt=4000,
                  gyro_rad=(0, 0, 0.001 * (k % 2)), accelerometer_m_s2=(0, 0, -9.81))
        for k in range(500)
    ]  # fmt: skip
    ulog.write(Path("flight.ulg"), ulog.added("sensor_combined", 0, 1), *samples)
    table = README.read_text().split("## What do you have?")[1].split("## ")[0]
    commands = re.findall(r"`quatprop (.*)` \|$", table, re.MULTILINE)
    assert len(commands) == table.count("\n| ") - 2  # the header, and arrays in Python
    for command in commands:
        run(*shlex.split(command), code=0)
    t, w = np.arange(5) / 10, np.ones((5, 3))
    (expression,) = re.findall(r"`(quatprop\.propagate.*?)`", table)
    assert eval(expression, {"quatprop": quatprop, "t": t, "w": w}).shape == (5, 4)  # noqa: S307


@pytest.mark.parametrize("recordings", [None, "nowhere", "some"])
def test_a_document_keeps_what_needs_recordings_that_are_not_there(tmp_path, recordings):
    """On a clone, to update the documents ended in a traceback."""
    (tmp_path / "some" / "ulog").mkdir(parents=True)
    (tmp_path / "some" / "ulog" / "sample.ulg").write_bytes(b"")
    path, folder = tmp_path / "guide.md", tmp_path / "run"
    folder.mkdir()
    command = "```console\n$ echo {}\n{}\n```\n"
    kept = f"## Robot\n\n{command.format('robot.bag', 'as it was')}"
    path.write_text(f"# Guide\n\n{command.format('new', 'old')}\n{kept}\n## End\n")
    document = Document(path, folder, recordings and tmp_path / recordings)
    assert document.run() == f"# Guide\n\n{command.format('new', 'new')}\n{kept}\n## End\n"
    assert document.missing == ["robot.bag"]


def test_what_is_cited_is_this_version():
    """The entry for BibTeX in the README."""
    assert f"version = {{{__version__}}}" in README.read_text()


def test_the_library_guide_is_true(ran):
    """Every line of Python, one block after the other."""
    document = ran(GUIDES / "library.md")
    samples, passed, rate, done, sigma, parts, *recorded = document.printed.splitlines()
    assert (rate, done) == ("100.0", "done 1000")
    assert samples.startswith("1000 [-9.99772140e-01 ")
    assert passed.startswith("True 0.0001")
    assert sigma == "[0.00349753 0.00351605 0.01746708]"
    assert parts.startswith("True ")
    assert recorded == ["coning [1.0, 0.0, 0.0, 0.0]"] * 3
    assert len(document.names["attitudes"]) == 1000
    assert (document.folder / "euler.csv").read_text().startswith("t_ns,yaw_deg,pitch_deg,roll_deg")


def test_the_development_guide_adds_devices_formats_and_settings(ran, monkeypatch):
    """Messages and files are read by its rows, and its format and its setting are as it says."""
    document = ran(GUIDES / "development.md")
    row, columns, form, writer, options = map(
        document.names.get, ("row", "columns", "form", "PipeTable", "RunOptions")
    )
    ((name,),) = [row.types]
    monkeypatch.setitem(TYPES, name, row)
    channel = Channel("/t", name, "cdr", "ros2msg", b"uint64 stamp_us\nfloat64[3] rate\n")
    (found,) = found_in(channel)
    assert (found.field, found.row.unit, mark(found)) == ("rate", "deg/s", None)
    assert stamps(found) == [(["stamp_us"], ("us",))]

    monkeypatch.setattr(vocabulary, "ROWS", (*vocabulary.ROWS, columns))
    log, out = document.folder / "mine.csv", document.folder / "out.psv"
    log.write_text("MyTick,TurnX (deg/s),TurnY (deg/s),TurnZ (deg/s)\n0,60,0,0\n100000,0,0,0\n")
    module, _, writer_name = form.opener.partition(":")
    monkeypatch.setitem(
        sys.modules, f"quatprop.writers.{module}", SimpleNamespace(**{writer_name: writer})
    )
    monkeypatch.setitem(WRITERS, "psv", form)
    write(propagate(log), out)
    header, *rows = out.read_text().splitlines()
    assert header == "t_ns|qw|qx|qy|qz"
    assert [row.split("|")[0] for row in rows] == ["0", "100000000"]
    np.testing.assert_allclose(float(rows[1].split("|")[2]), np.sin(np.deg2rad(3.0)))

    keyword = keywords_of(options)["skip"]
    assert keyword("3") == 3
    assert keyword.group in GROUPS


def test_a_batch_of_one_machine_is_done(ran, tmp_path):
    """A folder, a pattern and a list of names lead to an output each; the rest has other tests."""
    text = (GUIDES / "fleets.md").read_text().split("## Object stores")[0]
    (tmp_path / "fleets.md").write_text(text)
    ran(tmp_path / "fleets.md")
    assert sorted(path.name for path in (tmp_path / "attitudes").rglob("*.parquet")) == [
        "a.csv.parquet", "imu.bag.parquet",
    ]  # fmt: skip


def test_the_recipe_for_episodes_reads_each_on_its_own(ran, tmp_path):
    """By a loop over the command as by pandas."""
    begin, *sections = (GUIDES / "recipes.md").read_text().split("\n## ")
    (chosen,) = [section for section in sections if section.startswith("Episodes and sensors")]
    (tmp_path / "recipes.md").write_text(f"{begin}\n## {chosen}")
    ran(tmp_path / "recipes.md")
    for episode, rate in enumerate(((0.1, 0.2, 0.3), (0.5, 0.2, 0.1))):
        shown, read = (
            quatprop.read_attitudes(tmp_path / f"episode_{episode}.{suffix}")
            for suffix in ("csv", "parquet")
        )
        assert shown.t_ns.tolist() == read.t_ns.tolist() == [0, 10**7, 2 * 10**7]
        np.testing.assert_array_equal(shown.wxyz, read.wxyz)
        np.testing.assert_allclose(shown.wxyz[1, 1:], np.multiply(rate, 0.005), rtol=1e-5)


def test_recipes_for_joints_folders_and_opensim_write_what_they_say(ran, tmp_path):
    """A pose that is zero, a row for each log, a file of two sensors with one header."""
    ran(GUIDES / "recipes.md")
    rows = [line.split(",") for line in (tmp_path / "zeroed.csv").read_text().splitlines()]
    (angles,) = (row[1:] for row in rows if row[0] == "1700000002000000000")
    assert np.abs(np.array(angles, float)).max() < 1e-12
    assert max(abs(float(row[1])) for row in rows[1:]) > 10
    (log,) = (tmp_path / "folder.csv").read_text().splitlines()[1:]
    assert log.startswith("a.csv,done,2000,19.99")
    lines = (tmp_path / "leg.sto").read_text().splitlines()
    assert sum(line.startswith("DataType") for line in lines) == 1
    own = {name: (tmp_path / name).read_text().splitlines() for name in STO}
    cells = [[line.split("\t")[1] for line in own[name][4:]] for name in STO]
    assert [line.split("\t")[1:] for line in lines[4:]] == [
        [*row] for row in zip(*cells, strict=True)
    ]


STO = ("femur_r_imu.sto", "tibia_r_imu.sto")
"""Files of one sensor each, in the order of their columns."""


def headings(text):
    """Return the headings of a document, with the anchors that they have."""
    heads = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return [(head, re.sub(r"[^a-z0-9 -]", "", head.lower()).replace(" ", "-")) for head in heads]


def test_references_say_what_the_program_says_of_itself():
    """`make documents` writes them from options, docstrings and reports."""
    assert (GUIDES / "reference.md").read_text() == reference()
    assert (GUIDES / "api.md").read_text() == python_reference()


def keys_in(value):
    """Yield the keys of JSON, but for those that are names of settings, files and errors."""
    parts = value.items() if isinstance(value, dict) else enumerate(value)
    for key, item in parts:
        if isinstance(key, str):
            yield key
        if isinstance(item, dict | list) and key not in {"settings", "files", "origins"}:
            yield from keys_in(item)


@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
def test_the_reference_has_every_key_of_a_report(tmp_path):
    """Of a run with a gyroscope's errors and a bias, and of a comparison that fails."""
    log, out = ROOT / "sample_logs" / "rest.parquet", tmp_path / "out.csv"
    report = tmp_path / "report.json"
    run("propagate", log, "-o", out, "-q", "--report", report, "--bias", "static", code=0)
    wanted = {*keys_in(json.loads(report.read_text()))}
    truth = ROOT / "sample_logs" / "rest.truth.parquet"
    options = ("--json", "--tol", "1e-9deg", "--window", "1s", "--align", "yaw")
    wanted |= {*keys_in(json.loads(run("compare", out, truth, *options, code=1).stdout))}
    described = {*re.findall(r"`(\w+)`", (GUIDES / "reference.md").read_text())}
    assert wanted <= described, wanted - described


def test_each_key_of_a_report_has_a_sentence_of_its_own():
    """Several keys shared one that listed what each of them is, in order."""
    _, *classes = reference().split("| key | type | meaning |\n")
    assert len(classes) > 20
    for one in classes:
        table = one.partition("\n\n")[0]
        rows = re.findall(r"(?m)^\| `(\w+)` \| .* \| (.*) \|$", table)
        said = [sentence for _, sentence in rows]
        assert [name for name, sentence in rows if said.count(sentence) > 1] == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.stem)
def test_links_lead_somewhere(document):
    """To files of this repository, and to headings in them."""
    text = document.read_text()
    for target in re.findall(r"\]\((.*?)\)", text):
        if target.startswith("http"):
            continue
        name, _, anchor = target.partition("#")
        path = document.parent / name if name else document
        assert path.is_file(), target
        if anchor:
            assert anchor in dict(headings(path.read_text())).values(), target


def test_every_guide_and_target_is_named():
    """The README leads to every guide, and names no make target and no extra that is not there."""
    readme, makefile = README.read_text(), (ROOT / "Makefile").read_text()
    assert all(f"(quatprop/docs/{path.name})" in readme for path in GUIDES.glob("*.md"))
    targets = re.findall(r"[`\n]make ([\w-]+)", readme)
    assert [target for target in targets if f"\n{target}:" not in makefile] == []
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert {*re.findall(r"\.\[(\w+)\]", readme)} <= {*project["optional-dependencies"]}
