"""Hostile YAML, TOML and JSON: one sentence, in little time and memory."""

import json
import math
import random
import time
from contextlib import suppress
from pathlib import Path

import pytest
from make.commands import refused, run
from make.tables import write_rates

import quatprop
from quatprop.base.guarded_text import ContentError, read_bytes, read_json, read_toml, read_yaml

MERGED = "a0: &a0 {k: 1}\n" + "".join(
    f"a{k}: &a{k} {{<<: [{','.join([f'*a{k - 1}'] * 9)}], k{k}: 1}}\n" for k in range(1, 9)
)
LAUGHS = "a0: &a0 [1]\n" + "".join(
    f"a{k}: &a{k} [{','.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 9)
)
DEEP = "it is nested more than 64 levels deep"
LONG = "a number of more than 300 digits"

NO_TEXT = "text that is not Unicode, or has a zero byte"
AGAIN = "it is not TOML: Cannot overwrite a value "
TWICE = "it is neither YAML nor JSON: line 3: found duplicate key "

REFUSED = [
    (read_yaml, "matrix: &a [*a,*a,*a]", "line 1: a value contains itself"),
    (read_yaml, "a: 1\n? &a [*a]\n: b", "line 2: a value contains itself"),
    (read_yaml, MERGED, "line 7: its aliases stand for more than 262,144 values"),
    (read_yaml, LAUGHS, "line 7: its aliases stand for more than 262,144 values"),
    (read_yaml, "[" * 1_000_000, f"line 1: {DEEP}"),
    (read_yaml, "- " * 100_000, DEEP),
    (read_yaml, "- " * 65 + "1", DEEP),
    (read_yaml, "[" * 256 + "]" * 256, DEEP),
    (read_yaml, "a: 1\nb: " + "[" * 257 + "]" * 257, f"line 2: {DEEP}"),
    (read_yaml, "b: 1\na: " + "9" * 301, f"line 2: {LONG}"),
    (read_yaml, "a: [1, 0x" + "f" * 250 + "]", f"'a.1': {LONG}"),
    (read_yaml, 'a: {b: "x\\0"}', f"'a.b': {NO_TEXT}"),
    (read_yaml, '"x\\0": 1', f"'': {NO_TEXT}"),
    (read_yaml, "a: 1\nb: 2\na: 3", TWICE + '"a" with value "3" (original value: "1")'),
    (read_yaml, b"a: \xff", "it is not UTF-8 text: byte 3"),
    (read_yaml, "a: 2001-99-99", "it is neither YAML nor JSON"),
    (read_yaml, "!!bool x", "it is neither YAML nor JSON"),
    (read_yaml, "a: \x00", "it is neither YAML nor JSON"),
    (read_toml, b"a = " + b"[" * 100_000, DEEP),
    (read_toml, b"a" + b".a" * 100_000 + b" = 1", f"line 1: {DEEP}"),
    (read_toml, b"a" + b".a" * 256 + b" = 1", DEEP),
    (read_toml, b"a" + b".a" * 257 + b" = 1", f"line 1: {DEEP}"),
    (read_toml, b"a = " + b"[" * 64 + b"1" + b"]" * 64, DEEP),
    (read_toml, b"b = 1\na = " + b"9" * 301, f"line 2: {LONG}"),
    (read_toml, b"a = 0x" + b"f" * 250, f"'a': {LONG}"),
    (read_toml, b'a = ["\\u0000"]', f"'a.0': {NO_TEXT}"),
    (read_toml, b"a = 1\na = 2\n", AGAIN + "(at line 2, column 6)"),
    (read_toml, b"a = '\xff'", "it is not UTF-8 text: byte 5"),
    (read_json, "[" * 100_000, DEEP),
    (read_json, "[" * 65 + "1" + "]" * 65, DEEP),
    (read_json, '{"a": ' + "9" * 301 + "}", LONG),
    (read_json, '{"b": 2, "a": 1, "a": 3}', "'a' is there twice"),
    (read_json, '{"a": NaN}', "NaN is not a JSON number"),
    (read_json, '{"a": ["\\ud800"]}', f"'a.0': {NO_TEXT}"),
    (read_json, '{"a": "\\u0000"}', f"'a': {NO_TEXT}"),
    (read_json, '{"a":\n}', "it is not JSON: line 2: Expecting value"),
]  # fmt: skip


@pytest.mark.parametrize(("read", "text", "reason"), REFUSED, ids=range(len(REFUSED)))
def test_hostile_text_is_one_sentence(read, text, reason):
    """36 bytes took 9.8 GB, and 400 bytes half a minute; others were reported as bugs."""
    began = time.process_time()
    with pytest.raises(ContentError) as error:
        read(text)
    assert str(error.value) == reason
    assert time.process_time() - began < 3


def test_text_of_programs_is_read():
    """Aliases, numbers of 64 bits, dates, and bytes of file names that are not UTF-8."""
    assert read_yaml("a: &x [1, 2]\nb: *x\nc: {<<: {k: 1}}") == {
        "a": [1, 2], "b": [1, 2], "c": {"k": 1}
    }  # fmt: skip
    assert read_yaml("") is None
    assert len(read_toml(b"a = [" + b"0.5, " * 1000 + b"]")["a"]) == 1000
    assert read_toml(b"\xef\xbb\xbfa = 18446744073709551615\nb = 1979-05-27")["a"] == 2**64 - 1
    assert read_json(b'{"a": "\xff", "b": "\\udcff", "c": 1e999}') == {
        "a": "\udcff", "b": "\udcff", "c": math.inf
    }  # fmt: skip


@pytest.mark.parametrize("read", [read_yaml, read_toml, read_json])
def test_what_is_within_the_limits_is_read(read):
    """Whole numbers of 271 to 300 digits were refused, as of more than 300."""
    value, lists = ("a = ", 63) if read == read_toml else ("", 64)
    texts = ["9" * 300, "[" * lists + "1" + "]" * lists, *["0x" + "f" * 249] * (read != read_json)]
    assert all(read(f"{value}{text}".encode()) for text in texts)


@pytest.mark.parametrize(("limit", "bytes_read"), [((1000,), "1,000"), ((), "16,777,216")])
def test_a_file_without_end_is_refused(limit, bytes_read):
    """It is read up to the limit."""
    with pytest.raises(ContentError, match=f"^it is too large; {bytes_read} bytes are read at mos"):
        read_bytes("/dev/zero", *limit)


def test_a_file_of_the_limit_is_read(tmp_path):
    """One byte more is too large."""
    path = tmp_path / "file"
    path.write_bytes(bytes(1000))
    assert read_bytes(path, 1000) == bytes(1000)
    with pytest.raises(ContentError, match="999 bytes"):
        read_bytes(path, 999)


PIECES = [
    "[", "]", "{", "}", ": ", ",", "- ", "\n", "&a ", "*a", "<<: ", "!!set ", "!x ", '"', "'",
    "\\u0000", "\\ud800", "9" * 400, "0x1", "1e999", "nan", ".inf", "null", "~", "#", "|\n",
    "%YAML 1.9", "---\n", "a", "a = ", "[[a]]\n", "'''", "\x00", "\ufeff", "1979-05-27", "=",
    "\u2028", "\x85", "? ", "!!binary ", "!!omap ", "\t", "12:30:45", "TRUE", "@", "`"
]  # fmt: skip


@pytest.mark.parametrize("read", [read_yaml, read_toml, read_json])
def test_no_text_gives_another_error(read):
    """Texts made of what means something in these formats, and valid ones with a flipped byte."""
    chosen = random.Random(24)
    valid = {
        read_yaml: b"a: &x [1, 2.5, 'b']\nb: {c: *x, <<: {d: !!set {e}}}\nf: 2001-01-01\n",
        read_toml: b"[case.a]\nlog = 'x'\nn = [1, 2.5]\nt = 1979-05-27T07:32:00Z\n[b]\nc = {d=1}\n",
        read_json: b'{"a": [1, 2.5, "b"], "c": {"d": null, "e": "\\u00e4"}}',
    }[read]
    texts = ["".join(chosen.choices(PIECES, k=chosen.randint(1, 12))).encode() for _ in range(400)]
    for _ in range(200):
        flipped = bytearray(valid)
        flipped[chosen.randrange(len(valid))] ^= 1 << chosen.randrange(8)
        texts.append(bytes(flipped))
    for text in texts:
        with suppress(ContentError):
            read(text)


def test_nothing_else_reads_these_formats():
    """Others would have none of the limits; rows and messages of logs have their own."""
    allowed = {"guarded_text", "jsonl", "json", "arrow"}
    for path in Path(quatprop.__file__).parent.rglob("*.py"):
        text = path.read_text()
        if path.stem not in allowed:
            assert "json.load" not in text, path
            assert "tomllib" not in text, path
            assert "yaml.load" not in text, path


ROWS = [[k * 10_000_000, 0, 0, 1] for k in range(3)]
SUITE = '[case.a]\nlog = "log.csv"\nreference = "r.parquet"\n'
RAW = [b"[" * 100_000, b"9" * 5000, b"\xff"]


@pytest.mark.parametrize("raw", RAW, ids=range(len(RAW)))
@pytest.mark.parametrize("use", ["--config", "--calibration", "--imu", "suite", "lock"])
def test_a_hostile_file_is_named(tmp_path, use, raw):
    """Whatever is in a file that an option names: exit code 2, its name, and no bug."""
    log = write_rates(tmp_path / "log.csv", ROWS)
    file = tmp_path / "hostile.toml"
    arguments = ["propagate", log, "-o", tmp_path / "out.csv", use, file]
    if use in {"suite", "lock"}:
        arguments = ["check", file]
    if use == "lock":
        file.write_text(SUITE)
        file = tmp_path / "hostile.lock.json"
    file.write_bytes(raw)
    result = run(*arguments, code=2)
    assert result.output.startswith("Error: ")
    assert f"{file}: " in result.output
    assert "bug" not in result.output
    assert not (tmp_path / "out.csv").exists()


HOSTILE = [None, True, 10**299, "\ud800", [], {"a": 1}]


def replaced(value, part):
    """Yield a value with each of its parts replaced by another in turn."""
    yield part
    if isinstance(value, dict):
        for key in value:
            yield from ({**value, key: one} for one in replaced(value[key], part))
    elif isinstance(value, list):
        for place, old in enumerate(value):
            yield from ([*value[:place], one, *value[place + 1 :]] for one in replaced(old, part))


def test_a_lock_with_any_other_value_is_refused_or_judged(tmp_path):
    """Every value of a lock, replaced by one of another kind."""
    write_rates(tmp_path / "log.csv", ROWS)
    suite, lock = tmp_path / "s.toml", tmp_path / "s.lock.json"
    suite.write_text(SUITE)
    run("check", suite, "--update", code=0)
    valid = json.loads(lock.read_text())
    for part in HOSTILE:
        for content in replaced(valid, part):
            lock.write_text(json.dumps(content))
            result = run("check", suite, "--explain")
            assert result.exit_code in {0, 2}, content
            assert "bug" not in result.output, content


@pytest.mark.parametrize(
    ("words", "is_whole"),
    [
        ("--start 0001-01-01T00:00:00Z", True),
        ("--end 9999-12-31T23:59:59Z", True),
        ("--start 9999-12-31T23:59:59Z", False),
        ("--end 0001-01-01T00:00:00Z", False),
        (f"--start +{10**30}s", False),
        (f"--end +{10**30}s", False),
    ],
)
def test_a_time_beyond_the_clock_is_no_bug(tmp_path, words, is_whole):
    """Times of 64 bits end in 2262."""
    log = write_rates(tmp_path / "log.csv", ROWS)
    arguments = ["propagate", log, "-o", tmp_path / "o.csv", *words.split()]
    if is_whole:
        run(*arguments, code=0)
    else:
        assert "bug" not in refused(*arguments)
