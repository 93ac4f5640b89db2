"""The error between two attitude series: matched in time, aligned, measured, explained."""
