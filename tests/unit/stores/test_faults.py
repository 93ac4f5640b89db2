"""Object stores whose objects change, that refuse requests, or whose keys are odd."""

import re

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from fuzz.stores import Faults
from make.batches import batch, entries, said, spin
from make.commands import refused, run
from make.tables import write_rates

from quatprop.stores.objects import _s3, below, split_address
from quatprop.stores.remote import get, put, upload


def rates_table(path, seed, rows=80_000):
    """Write a table of noise as rates, of about 2 MB."""
    columns = np.random.default_rng(seed).standard_normal((3, rows))
    names = dict(zip(("wx", "wy", "wz"), columns, strict=True))
    pq.write_table(pa.table({"t_ns": np.arange(rows) * 10**7, **names}), path)
    return path


def test_a_log_that_is_replaced_while_it_is_read_is_read_again(tmp_path, bucket, store_server):
    """Rows of two objects came to be in one output, which was called done."""
    old, new = (rates_table(tmp_path / f"{seed}.parquet", seed) for seed in (1, 2))
    address, gets = f"{bucket}/a.parquet", []
    upload(old, address)

    def replace(method, path):
        if method == "GET" and path.endswith("a.parquet"):
            gets.append(path)
            if len(gets) == 3:
                upload(new, address)

    store_server.before = replace
    run("propagate", address, "-o", tmp_path / "far.csv", code=0)
    run("propagate", new, "-o", tmp_path / "near.csv", code=0)
    assert len(gets) > 3
    assert (tmp_path / "far.csv").read_bytes() == (tmp_path / "near.csv").read_bytes()


def test_a_log_that_is_replaced_all_the_time_is_refused(tmp_path, bucket, store_server):
    """Nothing is written of an object that is another one after each reading."""
    address, rates = spin(f"{bucket}/a.csv"), iter(range(1, 99))

    def replace(method, path):
        if method == "GET" and path.endswith("a.csv"):
            spin(address, rate=next(rates))

    store_server.before = replace
    words = "it was replaced while it was read; try again when it is no longer being written"
    for command in (["propagate", address, "-o", tmp_path / "a.csv"], ["info", address]):
        assert refused(*command) == f"Error: {address}: {words}"
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["run?2.csv", "log?id=3.csv", "a%20b c.csv", "a+b&c=d.csv"])
def test_a_listed_key_is_not_parsed_as_an_address(tmp_path, bucket, name):
    """The part before a question mark was read instead: another object."""
    spin(f"{bucket}/p/{name.partition('?')[0]}", samples=9)
    put(f"{bucket}/p/{name}", b"t_ns,wx,wy,wz\n0,0,0,1\n100000000,0,0,1\n")
    for given in (f"{bucket}/p", f"{bucket}/p/*.csv", f"{bucket}/p/{name}"):
        done = batch(given, "-o", tmp_path / "out", "--to", "csv", code=0)
        assert said(done).startswith("1 of 1 logs done, 2 samples")
        assert (tmp_path / "out" / f"{name}.csv").exists()


def test_an_address_keeps_its_parameters():
    """Only names of parameters begin them, and names below an address are quoted where needed."""
    address = "s3://k:s@b/p?region=eu&scheme=http"
    assert split_address(address) == ("s3://k:s@b/p", "region=eu&scheme=http")
    assert below(address, "a?b") == "s3://k:s@b/p/a?b?region=eu&scheme=http"
    assert split_address(below(address, "a?b"))[0] == "s3://k:s@b/p/a?b"
    assert below("gs://b/p?x=1", "a?b%") == "gs://b/p/a%3Fb%25?x=1"


def test_a_burst_of_refusals_is_waited_for(tmp_path, bucket, store_server):
    """Logs failed, with the advice to check the address."""
    address, times = spin(f"{bucket}/a.csv"), iter(range(99))
    store_server.before = lambda *_: "503 Slow Down" if next(times) < 2 else None
    run("propagate", address, "-o", tmp_path / "a.csv", code=0)
    store_server.before = lambda *_: "503 Slow Down"
    words = refused("info", address)
    assert words.startswith(f"Error: {address}: the store is overloaded (")
    assert words.endswith("; try again later, or with fewer processes")


def test_a_log_that_does_not_open_at_once_is_no_folder(bucket, store_server, monkeypatch):
    """The error is that of the store, not that there is no bag."""
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    _s3.cache_clear()
    address, times = spin(f"{bucket}/a.csv"), iter(range(99))
    store_server.before = lambda *_: "503 Slow Down" if next(times) < 2 else None
    assert refused("info", address).startswith(f"Error: {address}: the store is overloaded (")
    assert next(times) == 3
    _s3.cache_clear()


def test_a_store_that_refuses_every_tenth_request_loses_no_log(tmp_path, bucket, store_server):
    """A few of many cases of `fuzz/stores.py`."""
    for number in range(8):
        spin(f"{bucket}/in/{number}.csv")
    store_server.before = Faults("refuse", 0.1)
    done = batch(f"{bucket}/in", "-o", tmp_path / "out", "--retries", "3", "-q", code=0)
    assert done.stderr == ""
    assert store_server.before.count
    states = {entry["state"] for entry in entries(tmp_path / "out").values()}
    assert states == {"done"}


def test_the_address_says_how_requests_are_signed_and_where_they_go(
    bucket, store_server, monkeypatch
):
    """Requests were always signed, which fails for those who have no keys."""
    put(f"{bucket}/a", b"")
    seen = []
    application = store_server._application  # noqa: SLF001

    def noted(environment, start_response):
        key = "AWS4-HMAC-SHA256 Credential=key/20260101/us-east-1/s3/aws4_request"
        seen.append(environment.setdefault("HTTP_AUTHORIZATION", f"{key}, unsigned"))
        return application(environment, start_response)

    def signed(who="", parameters=""):
        get(f"{bucket}/a{parameters}".replace("://", f"://{who}"))
        return seen[-1]

    monkeypatch.setattr(store_server, "_application", noted)
    assert re.search("Credential=key/[0-9]+/us-east-1/.*, SignedHeaders", signed())
    assert signed("anonymous@").endswith(", unsigned")
    assert "Credential=other+/" in signed("other%2B:se%2Fcret@")
    assert "/eu-west-1/s3/" in signed(parameters="?region=eu-west-1")
    place = store_server.address.removeprefix("http://")
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:1")
    assert signed(parameters=f"?endpoint_override={place}&scheme=http")
    monkeypatch.setenv("AWS_ENDPOINT_URL_S3", store_server.address)
    monkeypatch.delenv("AWS_REGION")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "eu-north-1")
    assert "/eu-north-1/s3/" in signed("key:secret@")


def test_a_result_is_written_to_a_store(tmp_path, bucket):
    """Only a batch could do so; the object appears when it is complete."""
    log = write_rates(tmp_path / "a.csv", ["0,0,0,1", "100000000,0,0,1"])
    near, far = tmp_path / "a.parquet", f"{bucket}/a.parquet"
    run("propagate", log, "-o", near, code=0)
    run("propagate", log, "-o", far, "--report", f"{bucket}/r.json", code=0)
    assert get(far) == near.read_bytes()
    assert get(f"{bucket}/r.json").startswith(b"{")
    run("convert", far, f"{bucket}/b.csv", code=0)
    run("convert", near, tmp_path / "b.csv", code=0)
    assert get(f"{bucket}/b.csv") == (tmp_path / "b.csv").read_bytes()
    run("propagate", log, "-o", f"{bucket}/bag", "--to", "rosbag2", code=0)
    assert "exists already" in refused("propagate", log, "-o", f"{bucket}/bag", "--to", "rosbag2")
    words = refused("convert", far, far)
    assert words == f"Error: {far}: this is an input of the run; choose another output"
