"""quatprop turns recorded gyroscope logs into attitude.

It reads body-rate samples, accumulates the exact constant-rate step of each, and writes unit
quaternions. The conventions below hold in every module; equation numbers are those of the article
"Quaternion kinematics and angular velocity" (PhysicsLibrary, object 1105, version 3) [1]_.

Conventions
-----------
Frames
    Right-handed and orthonormal: the body frame B, in which the gyroscope is fixed, and the
    reference frame I.
Quaternion
    Hamilton: ij = k. Mathematics is scalar first, q = w + x i + y j + z k (eq. 1).
Attitude
    ``q = q_I_B`` maps body to reference: v_I = q v_B q* (eqs. 2 and 3). q and -q are the same
    attitude; two attitudes are compared by the geodesic angle between them.
Angular rate
    One vector, resolved in the body frame (eq. 12: q' = 1/2 q w_B, multiplied on the right) or in
    the reference frame (eq. 16: q' = 1/2 w_I q, multiplied on the left), with w_I = R(q) w_B
    (eq. 5).
Step
    dq = cos(abs(w) dt / 2) + w / abs(w) sin(abs(w) dt / 2), exact for a rate that is constant over
    dt (eq. 35); q[k+1] = q[k] dq[k] for body rates (eq. 36), q[k+1] = dq[k] q[k] for inertial ones.
    N samples give N attitudes, and the first is q0.
Layout
    Scalar first or scalar last is an order of columns in a file. Internally, all quaternions are
    ``wxyz``.

Data types
----------
t_ns
    Timestamps, shape ``(N,)``, int64, ns; time never passes through a float.
rate
    Angular rates, shape ``(N, 3)``, float64, rad/s.
rotvec
    Rotation vectors, shape ``(N, 3)``, float64, rad: axis times angle.
wxyz
    Attitudes, shape ``(..., 4)``, float64, unit length.

References
----------
.. [1] "Quaternion kinematics and angular velocity", PhysicsLibrary, object 1105, 2026.

Examples
--------
Half a turn about z in one second, sampled at 8 Hz:

>>> import numpy as np
>>> import quatprop
>>> rates = quatprop.GyroSeries(np.arange(9) * 125_000_000, [[0, 0, np.pi]] * 9)
>>> attitudes = quatprop.propagate(rates)
>>> attitudes.wxyz[-1].round(12).tolist()
[0.0, 0.0, 0.0, 1.0]
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from quatprop.version import __version__ as __version__

if TYPE_CHECKING:
    from quatprop.api.attitudes import compare, convert, write
    from quatprop.api.batch import batch
    from quatprop.api.calibration import calibrate
    from quatprop.api.noise import noise
    from quatprop.api.propagation import PropagatedSeries, propagate
    from quatprop.api.reading import read_attitudes, read_rates
    from quatprop.api.tools import Simulation, info, plot, simulate
    from quatprop.batching.entries import ManifestEntry
    from quatprop.calibration.result import GyroCalibration
    from quatprop.comparison.result import Comparison
    from quatprop.comparison.statistics import ErrorStatistics
    from quatprop.conversion.job import ConversionReport
    from quatprop.errors import DataLossWarning, QuatpropError, QuatpropWarning, RemarkWarning
    from quatprop.pipeline.log_survey import LogSurvey
    from quatprop.pipeline.report import RunReport
    from quatprop.sensor_noise.result import Noise, NoiseTerm, NoiseTerms
    from quatprop.series import AttitudeSeries, GyroSeries
    from quatprop.timeline.counts import Counts

__all__ = [
    "AttitudeSeries",
    "Comparison",
    "ConversionReport",
    "Counts",
    "DataLossWarning",
    "ErrorStatistics",
    "GyroCalibration",
    "GyroSeries",
    "LogSurvey",
    "ManifestEntry",
    "Noise",
    "NoiseTerm",
    "NoiseTerms",
    "PropagatedSeries",
    "QuatpropError",
    "QuatpropWarning",
    "RemarkWarning",
    "RunReport",
    "Simulation",
    "batch",
    "calibrate",
    "compare",
    "convert",
    "info",
    "noise",
    "plot",
    "propagate",
    "read_attitudes",
    "read_rates",
    "simulate",
    "write",
]

_MODULES = {
    "AttitudeSeries": "quatprop.series",
    "Comparison": "quatprop.comparison.result",
    "ConversionReport": "quatprop.conversion.job",
    "Counts": "quatprop.timeline.counts",
    "DataLossWarning": "quatprop.errors",
    "ErrorStatistics": "quatprop.comparison.statistics",
    "GyroCalibration": "quatprop.calibration.result",
    "GyroSeries": "quatprop.series",
    "LogSurvey": "quatprop.pipeline.log_survey",
    "ManifestEntry": "quatprop.batching.entries",
    "Noise": "quatprop.sensor_noise.result",
    "NoiseTerm": "quatprop.sensor_noise.result",
    "NoiseTerms": "quatprop.sensor_noise.result",
    "PropagatedSeries": "quatprop.api.propagation",
    "QuatpropError": "quatprop.errors",
    "QuatpropWarning": "quatprop.errors",
    "RemarkWarning": "quatprop.errors",
    "RunReport": "quatprop.pipeline.report",
    "Simulation": "quatprop.api.tools",
    "batch": "quatprop.api.batch",
    "calibrate": "quatprop.api.calibration",
    "compare": "quatprop.api.attitudes",
    "convert": "quatprop.api.attitudes",
    "info": "quatprop.api.tools",
    "noise": "quatprop.api.noise",
    "plot": "quatprop.api.tools",
    "propagate": "quatprop.api.propagation",
    "read_attitudes": "quatprop.api.reading",
    "read_rates": "quatprop.api.reading",
    "simulate": "quatprop.api.tools",
    "write": "quatprop.api.attitudes",
}


def __getattr__(name: str) -> Any:
    """Import a public name on first use, so that ``quatprop --help`` starts fast."""
    if name not in _MODULES:
        raise AttributeError(f"module 'quatprop' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    """List the public names."""
    return [*__all__, "__version__"]
