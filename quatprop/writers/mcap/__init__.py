"""Attitudes as messages of an MCAP file."""
