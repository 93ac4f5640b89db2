"""Match columns of a table to rates, attitudes and biases."""
