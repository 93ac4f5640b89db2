"""Interpret the columns of a log: rates, attitudes, biases and their timestamps."""
