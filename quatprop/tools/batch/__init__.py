"""Many logs with the same settings, in processes or on a cluster."""
