"""Simulated logs with known true attitude: a motion, sampled by a gyroscope.

::

    motion.py     rest, spin, coning, tumbling, random walk: rate and attitude as functions of time
    gyroscope.py  sampling times, noise and bias
    simulate.py   output in any container that quatprop reads, and a file with the truth
"""
