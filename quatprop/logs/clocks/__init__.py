"""Which columns of a table are the time of its rows, and whose row each is."""
