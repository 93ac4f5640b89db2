"""Which columns of a table are the time, the rates or the attitude."""
