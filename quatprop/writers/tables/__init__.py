"""Attitudes as columns of text, Arrow and NumPy files."""
