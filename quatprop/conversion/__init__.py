"""Convert one attitude series: layout, convention, direction, sign, representation, file format.

Numbers are never computed anew where only their order or their sign changes, so that a conversion
there and back gives the same bits.
"""
