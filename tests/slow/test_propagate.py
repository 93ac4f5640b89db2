"""Half a million samples: against the 80-bit oracle, and through a pipe."""

import select
import subprocess
import threading

import numpy as np
import pytest
from make import oracle
from make.commands import INSTALLED

from quatprop.kinematics.propagate import attitudes


@pytest.mark.skipif(not oracle.EXTENDED, reason="longdouble has no 80 bits here")
def test_half_a_million_samples_against_the_oracle():
    """Final and worst error stay below 1e-14 rad, rows at unit length."""
    rng = np.random.default_rng(2)
    steps = rng.integers(4_500_000, 5_500_000, 500_000)
    t_ns = 1_700_000_000_000_000_000 + np.cumsum(steps)
    rate = rng.normal(size=(len(t_ns), 3))
    q = attitudes(t_ns, rate)
    assert oracle.angle(oracle.blocked(t_ns, rate), q).max() < 1e-14
    length = np.sqrt((q.astype(oracle.L) ** 2).sum(axis=1))
    assert np.abs(length - 1).max() <= 2 * np.finfo(float).eps


def test_rows_come_out_while_the_input_comes():
    """Of a pipe whose end is held back until the first attitudes are there."""
    rows = [b"%d,0.01,0.02,0.03\n" % (10**18 + k * 10**7) for k in range(500_000)]
    seen = threading.Event()

    def feed(stream):
        with stream:
            stream.write(b"t_ns,wx,wy,wz\n" + b"".join(rows[:-10]))
            stream.flush()
            seen.wait(60)
            stream.write(b"".join(rows[-10:]))

    command = [INSTALLED, "propagate", "-", "-o", "-", "-q", "--threads", "1"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        feeder = threading.Thread(target=feed, args=[process.stdin])
        feeder.start()
        came = select.select([process.stdout], [], [], 60)[0]
        seen.set()
        out = process.stdout.read()
        feeder.join()
    assert came, "nothing came out before the end"
    assert out.startswith(b"t_ns,qw,qx,qy,qz\n1000000000000000000,1,0,0,0\n")
    assert out.count(b"\n") == len(rows) + 1
    assert process.returncode == 0
