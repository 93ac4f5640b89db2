"""Rotation vectors, quaternions and their product: NumPy only, no files."""
