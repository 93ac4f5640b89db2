"""Order, gaps, clocks and time range of samples."""
