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

Folders
-------
The listing follows the data. A folder imports only from those above it (docs/development.md).

base
    What all share: errors and losses, text, times, provenance, threads and processes.
stores
    Bytes of local files and object stores.
settings
    Every setting in one row.
kinematics
    The core, NumPy only: increments, quaternions, the product, series, conventions.
timeline
    Timestamps: order, gaps, clocks, time range.
readers
    Logs as tables, what their columns mean, and the signals in them in rad/s, wxyz and ns.
writers
    Attitudes to files, one module for each format.
propagation
    One log from opening to the committed output.
comparison
    The error between two series.
estimation
    What differs between two sources of rotation.
tools
    The other commands: convert, batch, check, plot, noise, calibrate, crosscheck, simulate.
api, cli
    The library and the command line.

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

from quatprop.base import __version__ as __version__

if TYPE_CHECKING:
    from quatprop.api.attitudes import (
        PropagatedSeries,
        compare,
        convert,
        propagate,
        read_attitudes,
        read_metadata,
        read_rates,
        write,
    )
    from quatprop.api.tools import (
        FoundLog,
        Simulation,
        batch,
        calibrate,
        crosscheck,
        find_logs,
        info,
        noise,
        plot,
        simulate,
    )
    from quatprop.base.errors import DataLossWarning, QuatpropError, QuatpropWarning, RemarkWarning
    from quatprop.comparison.result import Comparison
    from quatprop.comparison.statistics import ErrorStatistics
    from quatprop.kinematics.series import AttitudeSeries, GyroSeries
    from quatprop.propagation.report import RunReport
    from quatprop.propagation.survey import LogSurvey
    from quatprop.timeline.counts import Counts
    from quatprop.tools.batch.manifest import ManifestEntry
    from quatprop.tools.calibration import GyroCalibration
    from quatprop.tools.conversion import ConversionReport
    from quatprop.tools.crosscheck.result import CrossCheck
    from quatprop.tools.noise_table import Noise, NoiseTerm, NoiseTerms

__all__ = [
    "AttitudeSeries",
    "Comparison",
    "ConversionReport",
    "Counts",
    "CrossCheck",
    "DataLossWarning",
    "ErrorStatistics",
    "FoundLog",
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
    "crosscheck",
    "find_logs",
    "info",
    "noise",
    "plot",
    "propagate",
    "read_attitudes",
    "read_metadata",
    "read_rates",
    "simulate",
    "write",
]

_MODULES = {
    "AttitudeSeries": "quatprop.kinematics.series",
    "Comparison": "quatprop.comparison.result",
    "ConversionReport": "quatprop.tools.conversion",
    "Counts": "quatprop.timeline.counts",
    "CrossCheck": "quatprop.tools.crosscheck.result",
    "DataLossWarning": "quatprop.base.errors",
    "ErrorStatistics": "quatprop.comparison.statistics",
    "FoundLog": "quatprop.api.tools",
    "GyroCalibration": "quatprop.tools.calibration",
    "GyroSeries": "quatprop.kinematics.series",
    "LogSurvey": "quatprop.propagation.survey",
    "ManifestEntry": "quatprop.tools.batch.manifest",
    "Noise": "quatprop.tools.noise_table",
    "NoiseTerm": "quatprop.tools.noise_table",
    "NoiseTerms": "quatprop.tools.noise_table",
    "PropagatedSeries": "quatprop.api.attitudes",
    "QuatpropError": "quatprop.base.errors",
    "QuatpropWarning": "quatprop.base.errors",
    "RemarkWarning": "quatprop.base.errors",
    "RunReport": "quatprop.propagation.report",
    "Simulation": "quatprop.api.tools",
    "batch": "quatprop.api.tools",
    "calibrate": "quatprop.api.tools",
    "compare": "quatprop.api.attitudes",
    "convert": "quatprop.api.attitudes",
    "crosscheck": "quatprop.api.tools",
    "find_logs": "quatprop.api.tools",
    "info": "quatprop.api.tools",
    "noise": "quatprop.api.tools",
    "plot": "quatprop.api.tools",
    "propagate": "quatprop.api.attitudes",
    "read_attitudes": "quatprop.api.attitudes",
    "read_metadata": "quatprop.api.attitudes",
    "read_rates": "quatprop.api.attitudes",
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
