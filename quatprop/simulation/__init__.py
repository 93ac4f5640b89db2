"""Logs whose true attitude is known: a motion, sampled by a gyroscope.

::

    motion.py     rest, spin, coning, tumbling, random walk: rate and attitude as functions of time
    gyroscope.py  when samples are taken, and what noise and bias do to them
    simulate.py   into any container that quatprop reads; the truth goes beside
"""
