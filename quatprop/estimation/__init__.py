"""Differences between two sources of rotation: clocks, axes and errors, with their certainty."""
