"""Batches of small logs, in folders and in object stores."""

from make.commands import run
from make.tables import write_rates

from quatprop.stores.remote import put
from quatprop.tools.batch.manifest import Manifest

UP_TO_DATE = "nothing to do: its output is up to date\n"


def batch(*arguments, **options):
    """Run `quatprop batch` with one process unless more are asked for."""
    return run("batch", "-j", "1", *arguments, **options)


def spin(path, rate=1.0, samples=5):
    """Write a log that turns about z; in a store, at an address."""
    rows = [f"{100_000_000 * k},0,0,{rate}" for k in range(samples)]
    if "://" not in str(path):
        return write_rates(path, rows)
    put(path, "\n".join(["t_ns,wx,wy,wz", *rows, ""]).encode())
    return path


def said(result):
    """Return the last line of what a batch says."""
    return result.stderr.splitlines()[-1]


def entries(folder):
    """Return the valid entries of a manifest, by output."""
    rows = Manifest(str(folder)).history().to_pylist()
    return {row["output"]: row for row in rows}


def outputs_in(folder):
    """Return the names of the outputs."""
    return sorted(path.name for path in folder.glob("*.parquet"))
