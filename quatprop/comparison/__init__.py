"""The parts of a comparison: association in time, clocks, alignment, figures, causes.

Each is mathematics on arrays; :mod:`quatprop.compare` puts them together.
"""
