"""Message decoding: from message bytes to NumPy columns, by the definitions that a log carries.

Nothing here depends on containers: the input is the blocks of messages that they yield.
"""
