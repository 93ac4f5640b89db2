"""Which columns of a table are rates, attitudes or biases; the first rows of these."""
