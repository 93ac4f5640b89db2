"""Choose the time column of a table, and the series that its rows belong to."""
