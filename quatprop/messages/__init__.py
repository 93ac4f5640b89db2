"""Message bytes to columns: definitions, plans, decoding, and which field is a rate.

This room knows no containers: it takes the blocks that readers give, and gives numpy columns.
"""
