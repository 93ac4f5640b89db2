"""Bias, calibration and mounting of a gyroscope, and stationary periods."""
