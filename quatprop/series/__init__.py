"""Series of body rates and series of attitudes.

Both are frozen, validated when they are made, and hold read-only arrays. A whole log and a batch of
one are the same type: readers yield many short series in order, writers take them in order.
"""

from quatprop.series.attitudes import SIGMA_COLUMNS as SIGMA_COLUMNS
from quatprop.series.attitudes import AttitudeSeries as AttitudeSeries
from quatprop.series.gyro import GyroSeries as GyroSeries
