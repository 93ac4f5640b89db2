"""Process one log: open it, propagate it, and write the output and a report."""
