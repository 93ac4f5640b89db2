"""Hundreds of simulated gyroscopes, and whether their calibrations err as much as stated.

``python -m fuzz.calibrations`` (in ``tests/``) prints the mean of squared errors over their
covariance of each model, and of all; standard deviations wrong by 5 % have to be noticed.
"""

import sys

from make.calibrations import MODELS, Ensemble, ensemble

RUNS = 400


def main() -> int:
    """Print the results; return how many are wrong."""
    comparisons, wrong = len(MODELS) + 1, 0
    ensembles = {", ".join(names): ensemble(names, RUNS) for names in MODELS}
    every = Ensemble(*map(sum, zip(*ensembles.values(), strict=True)))
    for names, each in {**ensembles, "all models": every}.items():
        is_exact = each.is_exact(comparisons)
        wrong += not is_exact
        print(f"{each.squares / each.count:.3f} {'' if is_exact else 'WRONG '}{names}")
    for fault in (0.95, 1.05):
        is_noticed = not every.is_exact(comparisons, fault=fault)
        wrong += not is_noticed
        print(f"sigmas times {fault}: {'noticed' if is_noticed else 'NOT NOTICED'}")
    return wrong


if __name__ == "__main__":
    sys.exit(bool(main()))
