"""Tables: columns of numbers and time from text, Arrow, NumPy and JSON Lines files."""
