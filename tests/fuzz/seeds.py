"""The command line and the report of programs that try one seed after another."""

import argparse
import warnings
from collections import Counter


def main(description, judged, count=2000):
    """Try seeds; print what is told of each; return of how many something is.

    `judged`: function of a seed that returns what it is counted as, and what is told or None
    """
    parser = argparse.ArgumentParser(description=description.partition("\n")[0])
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--count", type=int, default=count)
    chosen = parser.parse_args()
    warnings.simplefilter("ignore")
    failed, counts = 0, Counter()
    for seed in range(chosen.first, chosen.first + chosen.count):
        kind, told = judged(seed)
        counts[kind] += 1
        if told:
            failed += 1
            print(f"seed {seed}: {told}", flush=True)
    print(f"{chosen.count} seeds, of {failed} something is told; {dict(sorted(counts.items()))}")
    return failed
