"""What columns mean: names, and a row for each message type and program."""
