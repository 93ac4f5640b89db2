"""Series of body rates and series of attitudes.

Both are frozen, validated on construction, and hold read-only arrays. A whole log and a batch of it
have the same type: readers yield many short series in order, writers take them in order.
"""

from quatprop.series.attitudes import SIGMA_COLUMNS as SIGMA_COLUMNS
from quatprop.series.attitudes import AttitudeSeries as AttitudeSeries
from quatprop.series.gyro import GyroSeries as GyroSeries
