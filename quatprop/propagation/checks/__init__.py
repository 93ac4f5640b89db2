"""Checks of the rates: remarks on what a gyroscope does not give, such as frozen axes."""
