"""Body rates and attitudes of a log: the choice among them, and their reading."""
