"""Convert one attitude series: layout, convention, direction, sign, representation, file format.

If only the order or the sign of numbers changes they are not recomputed, so that a conversion and
its inverse give the same bits.
"""
