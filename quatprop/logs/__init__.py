"""From the tables of a log to rates, attitudes and biases: what columns mean, and their reading."""
