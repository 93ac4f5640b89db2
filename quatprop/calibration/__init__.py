"""Estimation of a gyroscope's calibration from a reference attitude."""
