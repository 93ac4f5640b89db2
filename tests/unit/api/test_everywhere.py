"""Properties of every function that the library exports."""

import inspect
import pickle
import warnings
from concurrent.futures import ThreadPoolExecutor

import pytest
from make.commands import run
from make.places import SAMPLE_LOGS

import quatprop
from quatprop import AttitudeSeries
from quatprop.base import errors

pytestmark = pytest.mark.usefixtures("no_causes")

BAG = SAMPLE_LOGS / "tumbling.bag"
TRUTH = SAMPLE_LOGS / "tumbling.truth.csv"
ARGUMENTS = {
    "path": "a.mcap",
    "suite": "a.toml",
    "reason": "it is odd; do other",
    "seen": ("/a", "/b"),
    "source": "/imu",
    "unknown": "the unit",
    "remedy": "it",
}
KINDS = [
    kind for name, kind in vars(errors).items()
    if isinstance(kind, type) and issubclass(kind, errors.QuatpropError) and name[0] != "_"
]  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_every_error_comes_back_from_another_process(kind):
    """One that was made with keywords, or of a generator, broke the pool instead."""
    needed = [
        one.name for one in inspect.signature(kind).parameters.values() if one.default is one.empty
    ]
    named = {name: ARGUMENTS[name] for name in needed}
    if "seen" in named:
        named["seen"] = (name for name in ARGUMENTS["seen"])
    error = kind(**named)
    error.side = "b"
    again = pickle.loads(pickle.dumps(error))  # noqa: S301  # our own
    assert (type(again), str(again), again.__dict__) == (kind, str(error), error.__dict__)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Write a log and attitudes that are cut, and attitudes one of which is none."""
    folder = tmp_path_factory.mktemp("cut")
    attitudes = quatprop.propagate(BAG)
    quatprop.write(attitudes, folder / "whole.bag")
    rest = folder / "rest.bag"
    run("simulate", rest, "--motion", "rest", "--noise", "1e-4", "--truth", "none", code=0)
    whole = {BAG: "cut.bag", folder / "whole.bag": "cut_attitudes.bag", rest: "cut_rest.bag"}
    for path, name in whole.items():
        content = path.read_bytes()
        (folder / name).write_bytes(content[: len(content) * 2 // 3])
    return folder


LOSING = {
    "read_rates": lambda folder: quatprop.read_rates(folder / "cut.bag"),
    "propagate": lambda folder: quatprop.propagate(folder / "cut.bag"),
    "calibrate": lambda folder: quatprop.calibrate(
        folder / "cut.bag", TRUTH, estimate="bias", window="50ms"
    ),
    "noise": lambda folder: quatprop.noise(folder / "cut_rest.bag"),
    "read_attitudes": lambda folder: quatprop.read_attitudes(folder / "cut_attitudes.bag"),
    "compare": lambda folder: quatprop.compare(folder / "cut_attitudes.bag", TRUTH),
    "convert": lambda folder: quatprop.convert(folder / "cut_attitudes.bag", folder / "a.csv"),
    "write": lambda folder: quatprop.write(
        AttitudeSeries([0], [[1, 0, 0, 0]], [[1, 2, 3]]), folder / "a.npy"
    ),
    "crosscheck": lambda folder: quatprop.crosscheck(folder / "cut.bag"),
    "plot": lambda folder: quatprop.plot(folder / "cut.bag", output=folder / "a.svg"),
}
"""Function -> a call that warns; the others return what there is to say."""


@pytest.mark.parametrize("name", LOSING)
def test_a_warning_is_about_the_line_that_calls(files, name):
    """Those of compare() pointed into the library; in a thread there is no line above."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        LOSING[name](files)
        direct = {one.filename for one in caught}
        with ThreadPoolExecutor(1) as pool:
            pool.submit(LOSING[name], files).result()
    assert direct == {__file__}
    assert {one.filename for one in caught} == {__file__}


def caught_of(call):
    """Return the warnings of a call by their kind."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        call()
    lost = [one.message for one in caught if one.category is quatprop.DataLossWarning]
    remarks = [one.message for one in caught if one.category is quatprop.RemarkWarning]
    return lost, remarks


@pytest.mark.parametrize("output", ["a.svg", None])
def test_a_plot_says_where_data_were_lost(files, output):
    """It said only that some were, and how many not; the others say the same of this log."""
    place = output and files / output
    lost, _ = caught_of(lambda: quatprop.plot(files / "cut.bag", output=place))
    read, _ = caught_of(lambda: quatprop.read_rates(files / "cut.bag"))
    assert lost
    assert [(str(one), one.messages) for one in lost] == [(str(one), one.messages) for one in read]


@pytest.mark.parametrize("output", ["a.svg", None])
def test_remarks_of_a_plot_have_codes(tmp_path, output):
    """They had none, so that no filter could name them."""
    log = tmp_path / "gap.csv"
    rows = [f"{k * 10**7 + (k > 50) * 10**9},0,0,{k % 7}\n" for k in range(100)]
    log.write_text("t_ns,wx_rad_s,wy_rad_s,wz_rad_s\n" + "".join(rows))
    place = output and tmp_path / output
    _, remarks = caught_of(lambda: quatprop.plot(log, output=place))
    assert "gaps" in {one.code for one in remarks}
    assert all(one.code and str(one).startswith(f"{log}: ") for one in remarks)


@pytest.mark.parametrize("output", ["a.svg", None])
def test_a_plot_of_an_error_says_what_was_lost_of_either(files, output):
    """Of what is drawn, and of the reference."""
    place, cut = output and files / output, files / "cut_attitudes.bag"
    for one, other in ((cut, TRUTH), (TRUTH, cut)):
        lost, _ = caught_of(lambda one=one, other=other: quatprop.plot(
            one, output=place, reference=other
        ))  # fmt: skip
        assert [str(each).startswith(f"{cut}: lost: ") for each in lost] == [True] * len(lost) != []


def test_no_function_is_left_out():
    """Of what is exported."""
    functions = {name for name in quatprop.__all__ if inspect.isfunction(getattr(quatprop, name))}
    assert functions - LOSING.keys() == {
        "info", "read_metadata", "simulate", "batch", "find_logs",
    }  # fmt: skip
