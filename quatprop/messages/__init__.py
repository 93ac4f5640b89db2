"""Message bytes to columns: what a schema says, done for a whole block at once."""
