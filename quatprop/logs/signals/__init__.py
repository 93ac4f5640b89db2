"""Choose and read the body rates and attitudes of a log."""
