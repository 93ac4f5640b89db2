"""From the bytes of messages to columns: definitions, decoding plans, and which field is what.

Nothing here depends on containers: it takes the blocks that they give, and gives NumPy columns.
"""
