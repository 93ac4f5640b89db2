"""Compare every source of rotation in recorded logs with every other."""
