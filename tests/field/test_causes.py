"""The cause named for a planted mistake is true, and its remedy works."""

import pytest
from fuzz.causes import judge
from fuzz.planted import pair

pytestmark = pytest.mark.filterwarnings("ignore::quatprop.QuatpropWarning")

SIMULATED = dict.fromkeys((3, 6, 16, 18, 35, 37, 41), "right") | {21: "named"}
RECORDED = {5: "right", 10: "right", 32: "right", 62: "right"}
AMBIGUOUS = {
    56: "right",  # of a conjugate, other rates lead elsewhere than the same steps reversed
    57: "none",  # the layout that was named was the one in which it was read
    97: "right",  # half an interval may be another rule, which is reported
    231: "none",  # lost motion was called a layout that left 13 % of the error
    863: "right",  # behind a mounting, a layout was called a conjugate
    867: "right",  # about one axis, rates of the opposite sign were called a conjugate
    20160: "right",  # only readings that leave a rate below the largest bias were tried
    30217: "right",  # as good a layout of A was taken for no layout of B
    40513: "named",  # the layout that was named was the one in which it was read
    20077: "right",  # a layout with a bias: that of A's rates depends on the layout
}
"""Number of a pair -> the verdict on what is named: the others are in ``make fuzz``."""


def _judged(number, folder):
    verdict, faults, _ = judge(pair(number, folder))
    return verdict, faults


@pytest.mark.parametrize(("number", "verdict"), SIMULATED.items())
def test_mistakes_in_simulated_rates(number, verdict):
    """Names were wrong for 9 % of such pairs, and half of the remedies did not deliver."""
    assert _judged(number, None) == (verdict, [])


@pytest.mark.parametrize(("number", "verdict"), (RECORDED | AMBIGUOUS).items())
def test_mistakes_in_recordings(shared_logs, number, verdict):
    """The same, of recordings with a reference."""
    assert _judged(number, shared_logs) == (verdict, [])
