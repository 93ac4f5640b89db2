"""``LOG:TOPIC`` names a topic wherever a log is read: commands, functions, suites, batches."""

import numpy as np
import pytest
from make.commands import run
from make.ros import imu_messages, write_messages
from make.suites import check, lock_of, write_suite
from scipy.spatial.transform import Rotation

import quatprop

T_NS = 1_700_000_000_000_000_000 + np.arange(2000) * 10_000_000
RATES = {"/left": [0.2, 0, 0.5], "/right": [0, 0, -0.25]}
"""Rates of the two topics, rad/s; each has its orientation, too."""


def turned(rate, t_ns=T_NS):
    """Return the attitudes of a body with a constant rate."""
    return Rotation.from_rotvec(np.outer((t_ns - T_NS[0]) * 1e-9, rate))


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """Return a log of two IMUs that turn differently."""
    path = tmp_path_factory.mktemp("two") / "two.mcap"
    random, messages = np.random.default_rng(1), []
    for topic, rate in RATES.items():
        rates = rate + 1e-3 * random.standard_normal((len(T_NS), 3))
        found = imu_messages(T_NS, rates, turned(rate).as_quat(scalar_first=True))
        messages += [(topic, *message[1:]) for message in found]
    write_messages(path, sorted(messages, key=lambda message: message[2]))
    return path


@pytest.mark.filterwarnings("ignore::quatprop.RemarkWarning")
@pytest.mark.parametrize(("topic", "rate"), RATES.items())
def test_python_functions_take_a_topic_in_the_name(log, tmp_path, topic, rate):
    """They took the whole name for that of a file."""
    name, end = f"{log}:{topic}", turned(rate)[-1]

    def is_end(wxyz):
        return (Rotation.from_quat(wxyz, scalar_first=True).inv() * end).magnitude() < 1e-2

    np.testing.assert_allclose(quatprop.read_rates(name).rate.mean(0), rate, atol=1e-4)
    assert is_end(quatprop.propagate(name).wxyz[-1])
    assert is_end(quatprop.read_attitudes(name).wxyz[-1])
    assert quatprop.compare(name, name, tol="1e-9rad").passed
    quatprop.convert(name, tmp_path / "a.csv")
    assert is_end(quatprop.read_attitudes(tmp_path / "a.csv").wxyz[-1])
    quatprop.plot(name, output=tmp_path / "a.png")
    quatprop.plot(name, reference=name)
    (entry,) = quatprop.batch(name, tmp_path / "out", processes=1)
    assert is_end(entry.final_wxyz)
    assert [source.source for source in quatprop.info(name).sources] == [topic]
    with pytest.raises(quatprop.QuatpropError, match=r"stationary|at rest"):
        quatprop.noise(name)
    with pytest.raises(quatprop.QuatpropError, match="another topic is given, '/other'; name one"):
        quatprop.read_rates(name, topic="/other")


def test_the_topics_of_a_batch_have_an_output_each(log, tmp_path):
    """A name with a topic was no file."""
    names = [f"{log}:{topic}" for topic in RATES]
    run("batch", *names, "-o", tmp_path, code=0)
    for topic, rate in RATES.items():
        wxyz = quatprop.read_attitudes(tmp_path / f"two.mcap{topic}.parquet").wxyz
        error = Rotation.from_quat(wxyz[-1], scalar_first=True).inv() * turned(rate)[-1]
        assert error.magnitude() < 1e-2


def test_suites_take_topics_in_names(log, tmp_path):
    """As a key of its own, or behind the name, of the log and of the reference."""
    text = "".join(
        f'[case.{topic[1:]}]\nlog = "{log}:{topic}"\nreference-log = "{log}:{topic}"\n'
        'tol = "0.5deg"\n'
        for topic in RATES
    )
    suite = write_suite(tmp_path, text)
    assert check(suite, "--update").exit_code == 0
    assert {name: pin["options"] for name, pin in lock_of(suite).items()} == {
        topic[1:]: {"topic": topic} for topic in RATES
    }
    suite.write_text(text.replace(':/right"\ntol', ':/left"\ntol'))
    assert check(suite).exit_code == 1


def test_a_new_suite_takes_the_topic_that_a_refusal_asks_for(log, tmp_path):
    """The option that it names was not one of this command."""
    suite = tmp_path / "new.toml"
    arguments = (suite, "--init", f"{log}:/left", "--reference-log", log)
    refusal = check(*arguments).stderr
    assert refusal.endswith("choose one with --topic-b\n")
    assert check(*arguments, "--topic-b", "/left", "--on-invalid", "drop").exit_code == 0
    assert 'topic = "/left"\n' in suite.read_text()
    assert 'reference-topic = "/left"\non-invalid = "drop"\n' in suite.read_text()
    assert check(suite).exit_code == 0
    said = check(suite, "--update", "--topic-b", "/left").stderr
    assert said.endswith("--topic-b requires --reference-log\n")
